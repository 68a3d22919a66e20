//! Causes that can end an episode.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};
use thiserror::Error;

/// A condition that ends an episode if its task or session says so. Every condition is noted when it is met, whether or
/// not it ends the episode.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Cause {
    /// The gate held for its whole window.
    Success,
    /// The state is no longer physically plausible. Ends every episode, whatever its task or session says, and excludes
    /// success.
    Diverged,
    /// The robot fell: its pelvis is lower or tilted further than the thresholds allow.
    Fall,
    /// A thing that must stand tipped: it leans further than the thresholds allow.
    Tip,
    /// A hand crushed a fragile thing of the task.
    Crush,
    /// A thing of the task was dropped.
    Drop,
    /// A thing that must stay in its place left it.
    Unseated,
    /// A fragile thing took an impact.
    Impact,
    /// The horizon was reached.
    TimeOut,
}

/// No cause has this name.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("there is no condition '{0}'; known ones are {names}", names = Cause::ALL.map(Cause::name).join(", "))]
pub struct UnknownCause(String);

impl Cause {
    /// All, success first: the order in which they are named as the cause of an end.
    pub const ALL: [Cause; 9] = [
        Cause::Success,
        Cause::Diverged,
        Cause::Fall,
        Cause::Tip,
        Cause::Crush,
        Cause::Drop,
        Cause::Unseated,
        Cause::Impact,
        Cause::TimeOut,
    ];

    /// Name in results and options.
    pub fn name(self) -> &'static str {
        match self {
            Cause::Success => "success",
            Cause::Diverged => "diverged",
            Cause::Fall => "fall",
            Cause::Tip => "tip",
            Cause::Crush => "crush",
            Cause::Drop => "drop",
            Cause::Unseated => "unseated",
            Cause::Impact => "impact",
            Cause::TimeOut => "time-out",
        }
    }
}

impl fmt::Display for Cause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Cause {
    type Err = UnknownCause;

    fn from_str(name: &str) -> Result<Self, UnknownCause> {
        Cause::ALL.into_iter().find(|cause| cause.name() == name).ok_or_else(|| UnknownCause(name.into()))
    }
}

/// A set of causes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Causes(u16);

impl Causes {
    /// A set without any cause.
    pub const NONE: Causes = Causes(0);

    /// The set of these causes.
    pub const fn of(causes: &[Cause]) -> Self {
        let (mut bits, mut i) = (0, 0);
        while i < causes.len() {
            bits |= 1 << causes[i] as u8;
            i += 1;
        }
        Self(bits)
    }

    /// True if the set contains a cause.
    pub const fn contains(self, cause: Cause) -> bool {
        self.0 & (1 << cause as u8) != 0
    }

    /// True if the set is empty.
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// The union with another set.
    #[must_use]
    pub const fn union(self, other: Causes) -> Self {
        Self(self.0 | other.0)
    }

    /// The intersection with another set.
    #[must_use]
    pub const fn intersection(self, other: Causes) -> Self {
        Self(self.0 & other.0)
    }

    /// This set without one of its causes.
    #[must_use]
    pub const fn without(self, cause: Cause) -> Self {
        Self(self.0 & !(1 << cause as u8))
    }

    /// Each, in the order of [`Cause::ALL`].
    pub fn iter(self) -> impl Iterator<Item = Cause> {
        Cause::ALL.into_iter().filter(move |cause| self.contains(*cause))
    }
}

impl FromIterator<Cause> for Causes {
    fn from_iter<I: IntoIterator<Item = Cause>>(causes: I) -> Self {
        causes.into_iter().fold(Self::NONE, |set, cause| set.union(Self::of(&[cause])))
    }
}

impl fmt::Display for Causes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let names: Vec<_> = self.iter().map(Cause::name).collect();
        f.write_str(&names.join("+"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_read_back() {
        for cause in Cause::ALL {
            assert_eq!(cause.name().parse(), Ok(cause));
        }
        let error = "falls".parse::<Cause>().expect_err("unknown").to_string();
        assert!(error.starts_with("there is no condition 'falls'; known ones are success, diverged, "), "{error}");
    }

    #[test]
    fn sets() {
        let set: Causes = [Cause::TimeOut, Cause::Success].into_iter().collect();
        assert_eq!(set, Causes::of(&[Cause::Success, Cause::TimeOut]));
        assert_eq!(set.to_string(), "success+time-out");
        assert_eq!(set.without(Cause::Success).iter().collect::<Vec<_>>(), [Cause::TimeOut]);
        assert!(set.intersection(Causes::of(&[Cause::Fall])).is_empty());
    }
}
