//! The two rulebooks by which an episode can be judged and end.

use std::fmt;
use std::str::FromStr;

use thiserror::Error;

/// A bag of an episode that was played by `strict` has both verdicts, because `strict` never ends an episode earlier.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
pub enum Protocol {
    /// The paper's gates and ends, for scores that compare with the published ones.
    Published,
    /// The same gates, with criteria that keep stunts from passing them. The default, and the one for rankings.
    #[default]
    Strict,
}

/// No protocol has this name.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("there is no protocol '{0}'; known ones are published, strict")]
pub struct UnknownProtocol(String);

impl Protocol {
    /// Both protocols, in the order in which results list them.
    pub const ALL: [Protocol; 2] = [Protocol::Published, Protocol::Strict];

    /// Name in results and options.
    pub fn name(self) -> &'static str {
        match self {
            Protocol::Published => "published",
            Protocol::Strict => "strict",
        }
    }
}

impl fmt::Display for Protocol {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Protocol {
    type Err = UnknownProtocol;

    fn from_str(name: &str) -> Result<Self, UnknownProtocol> {
        Protocol::ALL.into_iter().find(|protocol| protocol.name() == name).ok_or_else(|| UnknownProtocol(name.into()))
    }
}
