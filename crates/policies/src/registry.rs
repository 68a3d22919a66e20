//! Policies by name: the built-in ones, and those that a program adds.

use fiatlux_client::{Policy, PolicyError};

use crate::entry::Entry;
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

    /// Makes a policy by its name, such as `zero` or `replay:BAG`.
    ///
    /// # Errors
    /// [`PolicyError::Unknown`], or whatever keeps the policy from being made: a bag or a controller that cannot be loaded.
    pub fn make(&self, name: &str) -> Result<Box<dyn Policy>, PolicyError> {
        let (word, argument) = name.split_once(':').map_or((name, None), |(word, argument)| (word, Some(argument)));
        match self.0.iter().find(|entry| entry.word() == word && entry.takes(argument)) {
            Some(entry) => (entry.make)(argument.unwrap_or_default()),
            None => Err(PolicyError::Unknown {
                name: name.into(),
                hint: fiatlux_cli::did_you_mean(word, self.0.iter().map(Entry::word)),
                known: self.0.iter().map(|entry| entry.name).collect::<Vec<_>>().join(", "),
            }),
        }
    }
}
