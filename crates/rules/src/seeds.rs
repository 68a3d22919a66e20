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
    /// Judging policies, and nothing else.
    Judging,
    /// Training policies, and searching for motions.
    Training,
}

/// A seed that training and search must leave alone.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("seed {seed} is for {}, not for training or search; use seeds of {} and above", .owner.purpose(), SeedOwner::Training.seeds().start())]
#[allow(missing_docs)] // The messages say it.
pub struct ReservedSeed {
    pub seed: u64,
    pub owner: SeedOwner,
}

impl SeedOwner {
    /// All owners, by their seeds.
    pub const ALL: [SeedOwner; 4] = [SeedOwner::Published, SeedOwner::Tests, SeedOwner::Judging, SeedOwner::Training];

    /// The seeds that are for this purpose alone.
    pub fn seeds(self) -> RangeInclusive<u64> {
        match self {
            SeedOwner::Published => 0..=3,
            SeedOwner::Tests => 4..=63,
            SeedOwner::Judging => 64..=999,
            SeedOwner::Training => 1000..=u64::MAX,
        }
    }

    /// The owner of a seed.
    pub fn of(seed: u64) -> Self {
        Self::ALL.into_iter().find(|owner| owner.seeds().contains(&seed)).unwrap_or(SeedOwner::Training)
    }

    /// Its purpose, as in messages.
    pub fn purpose(self) -> &'static str {
        match self {
            SeedOwner::Published => "the published protocol",
            SeedOwner::Tests => "fixtures and tests",
            SeedOwner::Judging => "judging policies",
            SeedOwner::Training => "training and search",
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
        let message = "seed 999 is for judging policies, not for training or search; use seeds of 1000 and above";
        assert_eq!(refused, Err(message.into()));
    }
}
