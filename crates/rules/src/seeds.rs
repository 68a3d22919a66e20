//! Who owns which seeds.
//!
//! A policy is judged in rooms that neither its training nor its search has seen. So each seed has one owner.

use std::ops::RangeInclusive;

use thiserror::Error;

/// Purpose of a seed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SeedOwner {
    /// The four rooms of the published protocol.
    Published,
    /// Fixtures and tests of this project.
    Tests,
    /// Rooms that have been looked at while policies were made: for comparisons, not for rates.
    Seen,
    /// Training policies, and searching for motions.
    Training,
    /// Judging policies in rooms drawn afresh.
    Fresh,
}

/// A seed that training and search must leave alone.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("seed {seed} is for {}, not for training or search; use seeds {} to {}", .owner.purpose(), SeedOwner::Training.seeds().start(), SeedOwner::Training.seeds().end())]
#[allow(missing_docs)] // The messages say it.
pub struct ReservedSeed {
    pub seed: u64,
    pub owner: SeedOwner,
}

impl SeedOwner {
    /// All owners, by their seeds.
    pub const ALL: [SeedOwner; 5] =
        [SeedOwner::Published, SeedOwner::Tests, SeedOwner::Seen, SeedOwner::Training, SeedOwner::Fresh];

    /// The seeds that are for this purpose alone.
    pub fn seeds(self) -> RangeInclusive<u64> {
        match self {
            SeedOwner::Published => 0..=3,
            SeedOwner::Tests => 4..=63,
            SeedOwner::Seen => 64..=999,
            SeedOwner::Training => 1_000..=99_999,
            SeedOwner::Fresh => 100_000..=u64::MAX,
        }
    }

    /// The owner of a seed.
    pub fn of(seed: u64) -> Self {
        Self::ALL.into_iter().find(|owner| owner.seeds().contains(&seed)).unwrap_or(SeedOwner::Fresh)
    }

    /// Its purpose, as in messages.
    pub fn purpose(self) -> &'static str {
        match self {
            SeedOwner::Published => "the published protocol",
            SeedOwner::Tests => "fixtures and tests",
            SeedOwner::Seen => "comparisons",
            SeedOwner::Training => "training and search",
            SeedOwner::Fresh => "judging policies in rooms drawn afresh",
        }
    }

    /// Lets a seed pass that training and search may use. Whatever learns or searches calls this for every seed that it
    /// is given.
    ///
    /// # Errors
    /// [`ReservedSeed`] for a seed of another owner.
    pub fn check_training(seed: u64) -> Result<u64, ReservedSeed> {
        match Self::of(seed) {
            SeedOwner::Training => Ok(seed),
            owner => Err(ReservedSeed { seed, owner }),
        }
    }

    /// Rooms for training and search from a text such as `1000..1063`, the last included: the argument of programs that search.
    ///
    /// # Errors
    /// Another text, or a [`ReservedSeed`].
    pub fn training_rooms(text: &str) -> Result<RangeInclusive<u64>, String> {
        let ends = text.split_once("..").and_then(|(first, last)| Some((first.parse().ok()?, last.parse().ok()?)));
        let (first, last) = ends.ok_or_else(|| format!("'{text}' is not FIRST..LAST, such as 1000..1003"))?;
        for seed in [first, last] {
            Self::check_training(seed).map_err(|error| error.to_string())?;
        }
        Ok(first..=last)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The ranges meet without a gap, and training gets none but its own.
    #[test]
    fn every_seed_has_one_owner() {
        let mut next = 0;
        for owner in SeedOwner::ALL {
            let (first, last) = owner.seeds().into_inner();
            assert_eq!(first, next, "{owner:?}");
            for seed in [first, last] {
                assert_eq!(SeedOwner::of(seed), owner);
                assert_eq!(SeedOwner::check_training(seed).is_ok(), owner == SeedOwner::Training, "seed {seed}");
            }
            next = last.wrapping_add(1);
        }
        assert_eq!(next, 0);
        let refused = SeedOwner::check_training(999).map_err(|error| error.to_string());
        let message = "seed 999 is for comparisons, not for training or search; use seeds 1000 to 99999";
        assert_eq!(refused, Err(message.into()));
        assert_eq!(SeedOwner::training_rooms("1000..1003"), Ok(1000..=1003));
        for (text, part) in [
            ("64..127", "seed 64 is for comparisons"),
            ("2..1000", "seed 2 is for the published protocol"),
            ("1000..100000", "drawn afresh"),
            ("1000", "is not FIRST..LAST"),
        ] {
            let message = SeedOwner::training_rooms(text).err().unwrap_or_default();
            assert!(message.contains(part), "{text}: {message}");
        }
    }
}
