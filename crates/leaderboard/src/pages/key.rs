//! Names of episodes in addresses: `S05-s64-e0`.

use std::fmt;
use std::str::FromStr;

use fiatlux_grading::EpisodeRow;
use fiatlux_rules::Task;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Key {
    pub task: Task,
    pub seed: u64,
    /// Index among the episodes of this task and seed, from 0.
    pub episode: u64,
}

impl Key {
    /// The key of a row of results; `None` if this version does not know its task.
    pub fn of(row: &EpisodeRow) -> Option<Self> {
        Some(Self { task: row.task.parse().ok()?, seed: row.seed, episode: row.episode })
    }

    /// True if this is the episode of a row.
    pub fn is_of(&self, row: &EpisodeRow) -> bool {
        Self::of(row).is_some_and(|key| key == *self)
    }
}

impl fmt::Display for Key {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}-s{}-e{}", self.task, self.seed, self.episode)
    }
}

impl FromStr for Key {
    type Err = ();

    /// Reads the output of [`fmt::Display`] and nothing else: an episode has one address.
    fn from_str(text: &str) -> Result<Self, ()> {
        let mut parts = text.split('-');
        let number = |part: Option<&str>, prefix: char| part?.strip_prefix(prefix)?.parse().ok();
        let task = parts.next().and_then(|part| part.parse().ok()).ok_or(())?;
        let seed = number(parts.next(), 's').ok_or(())?;
        let episode = number(parts.next(), 'e').ok_or(())?;
        let key = Self { task, seed, episode };
        if key.to_string() == text { Ok(key) } else { Err(()) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_episode_has_one_address() {
        let key: Key = "S05-s64-e0".parse().expect("a key");
        assert_eq!((key.task, key.seed, key.episode), (Task::S05, 64, 0));
        assert_eq!(key.to_string(), "S05-s64-e0");
        for text in [
            "",
            "S05",
            "S05-s64",
            "S05-s064-e0",
            "S05-s+64-e0",
            "s05-s64-e0",
            "S05-s64-e0-",
            "S05-s64-e0/..",
            "S13-s0-e0",
            "S05-s18446744073709551616-e0",
            "../S05-s64-e0",
            "S05-s64-e\u{661}",
        ] {
            assert_eq!(text.parse::<Key>(), Err(()), "{text}");
        }
    }
}
