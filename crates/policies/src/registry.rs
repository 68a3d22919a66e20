//! Policies by name: the built-in ones, and those that a program adds.

use fiatlux_client::{Policy, PolicyError};
use fiatlux_rules::Relay;

use crate::entry::Entry;
use crate::expert::Expert;
use crate::{climb, expert, foreign, hands, hold, ladder, random, replay, see, stand, vla, walk, wbc, zero};

/// The policies of a program: the built-in ones, and more that it adds.
///
/// ```
/// use fiatlux_policies::{Entry, Policies, Zero};
///
/// let mine = Entry { name: "mine", does: "all actions 0", make: |_| Ok(Box::new(Zero::default())) };
/// let policies = Policies::default().with(mine);
/// assert_eq!(policies.make("mine")?.name(), "zero");
/// assert!(policies.make("yours").is_err());
/// # Ok::<(), fiatlux_client::PolicyError>(())
/// ```
#[derive(Debug, Clone)]
pub struct Policies(Vec<Entry>);

impl Default for Policies {
    fn default() -> Self {
        Self(vec![
            zero::ENTRY,
            random::ENTRY,
            hold::ENTRY,
            stand::ENTRY,
            wbc::ENTRY,
            walk::ENTRY,
            hands::ENTRY,
            ladder::ENTRY,
            climb::ENTRY,
            expert::ENTRY,
            see::ENTRY,
            see::carry::ENTRY,
            vla::ENTRY,
            foreign::GEAR,
            foreign::SONIC,
            replay::ENTRY,
        ])
    }
}

impl Policies {
    /// The same with one more, which hides an earlier one of its name.
    #[must_use]
    pub fn with(mut self, entry: Entry) -> Self {
        self.0.retain(|known| known.word() != entry.word());
        self.0.push(entry);
        self
    }

    /// All, in the order in which they were added.
    pub fn entries(&self) -> &[Entry] {
        &self.0
    }

    /// Makes a policy by its name, such as `zero`, `replay:BAG`, or that of a [`Relay`].
    ///
    /// # Errors
    /// [`PolicyError::Unknown`], or whatever keeps the policy from being made: a bag or a controller that cannot be loaded.
    pub fn make(&self, name: &str) -> Result<Box<dyn Policy>, PolicyError> {
        if let Some(relay) = Relay::of(name) {
            return relayed(&relay, |guest| self.make(guest));
        }
        let (word, argument) = name.split_once(':').map_or((name, None), |(word, argument)| (word, Some(argument)));
        match self.0.iter().find(|entry| entry.word() == word && entry.takes(argument)) {
            Some(entry) => (entry.make)(argument.unwrap_or_default()),
            None => Err(PolicyError::Unknown {
                name: name.into(),
                hint: fiatlux_proto::did_you_mean(word, self.0.iter().map(Entry::word)),
                known: self.0.iter().map(|entry| entry.name).collect::<Vec<_>>().join(", "),
            }),
        }
    }
}

/// The expert, with the relay's other policies for the subtasks that they are named for; `make` makes one of these by its name.
///
/// # Errors
/// Another policy than the expert is to play the errand, a subtask has two policies, or one of them cannot be made.
pub fn relayed(
    relay: &Relay,
    make: impl Fn(&str) -> Result<Box<dyn Policy>, PolicyError>,
) -> Result<Box<dyn Policy>, PolicyError> {
    if relay.host != "expert" {
        let reason =
            format!("{} does not play the errand subtask by subtask, as a relay needs; use expert", relay.host);
        return Err(PolicyError::Unfit { policy: "relay", reason });
    }
    let guests = relay.guests.iter().map(|guest| Ok((guest.task, make(&guest.policy)?)));
    Ok(Box::new(Expert::new()?.with(guests.collect::<Result<_, PolicyError>>()?)?))
}
