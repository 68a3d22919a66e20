//! Relays: one policy plays the errand, and others play single subtasks of it. Their names, and the names of their phases.

use std::fmt;
use std::str::FromStr;

use thiserror::Error;

use crate::task::Task;

/// Between the policies in the name of a relay.
const WITH: &str = " with ";
/// Between the subtask and the rest in the name of a phase.
const OF: &str = ": ";

/// A relay, as the name of its policy says: `expert with S03=stand with S11=mine`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Relay {
    /// Name of the policy that plays every other subtask.
    pub host: String,
    /// The others, in the order in which they were named.
    pub guests: Vec<Guest>,
}

/// A policy for one subtask of a relay: `S03=NAME`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Guest {
    /// One of S01 to S12.
    pub task: Task,
    /// Name of the policy.
    pub policy: String,
}

/// Why a text does not name a subtask and its policy.
#[derive(Debug, Error, PartialEq, Eq)]
#[error(
    "'{0}' does not name a subtask and its policy; write SUBTASK=POLICY, such as S03=stand, with one of S01 to S12"
)]
pub struct NotAGuest(String);

impl Relay {
    /// Reads the name of a policy; `None` for a policy that is not a relay.
    pub fn of(policy: &str) -> Option<Self> {
        let (host, guests) = policy.split_once(WITH)?;
        let guests = guests.split(WITH).map(str::parse).collect::<Result<_, _>>().ok()?;
        Some(Self { host: host.into(), guests })
    }

    /// The name of a phase of a subtask.
    pub fn phase(task: Task, phase: &str) -> String {
        if phase.is_empty() { task.short_id().into() } else { format!("{task}{OF}{phase}") }
    }

    /// The subtask of a phase that [`Relay::phase`] named; `None` where none is played.
    pub fn task_of(phase: &str) -> Option<Task> {
        let name = phase.split_once(OF).map_or(phase, |(task, _)| task);
        Task::SUBTASKS.into_iter().find(|task| task.short_id() == name)
    }
}

impl fmt::Display for Relay {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.host)?;
        self.guests.iter().try_for_each(|guest| write!(f, "{WITH}{guest}"))
    }
}

impl FromStr for Guest {
    type Err = NotAGuest;

    fn from_str(text: &str) -> Result<Self, NotAGuest> {
        let not = || NotAGuest(text.into());
        let (task, policy) = text.split_once('=').ok_or_else(not)?;
        let task = task.parse().ok().filter(|task| Task::SUBTASKS.contains(task)).ok_or_else(not)?;
        if policy.is_empty() { Err(not()) } else { Ok(Self { task, policy: policy.into() }) }
    }
}

impl fmt::Display for Guest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}={}", self.task, self.policy)
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn names_read_back() {
        let name = "expert with S03=vla openpi:model=a=b with S11=stand";
        let relay = Relay::of(name).unwrap();
        assert_eq!((relay.host.as_str(), relay.guests.len(), relay.guests[0].task), ("expert", 2, Task::S03));
        assert_eq!(relay.guests[0].policy, "vla openpi:model=a=b");
        assert_eq!(relay.to_string(), name);
        for plain in ["expert", "net with care", "expert with replace=zero", "expert with S03=", "expert with S13=zero"]
        {
            assert_eq!(Relay::of(plain), None, "{plain}");
        }
        let error = "replace=zero".parse::<Guest>().unwrap_err().to_string();
        assert!(error.contains("'replace=zero'") && error.contains("S01 to S12"), "{error}");
    }

    #[test]
    fn phases_name_their_subtask() {
        for phase in ["", "Lean", "way: on"] {
            assert_eq!(Relay::task_of(&Relay::phase(Task::S03, phase)), Some(Task::S03));
        }
        for phase in ["", "Stand", "Lean: S03", "replace: x"] {
            assert_eq!(Relay::task_of(phase), None, "{phase}");
        }
    }
}
