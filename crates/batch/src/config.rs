//! Settings of a batch.

use crate::{Bank, BatchError, Disturbances, Watch};

/// Most worlds of a batch.
pub const MAX_WORLDS: usize = 1 << 20;
/// Most threads of a batch.
pub const MAX_THREADS: usize = 1024;
/// Most starts of all banks together; each takes some kilobytes.
pub const MAX_STARTS: usize = 100_000;

/// When the next episode of a world begins, in the terms of Gymnasium.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Autoreset {
    /// In the step that ends the last one.
    #[default]
    SameStep,
    /// In the step after it, which ignores the action and pays nothing.
    NextStep,
    /// When the caller resets the world. Until then no step is taken.
    Disabled,
}

/// Settings of a batch.
#[derive(Debug, Clone)]
pub struct BatchConfig {
    /// Number of worlds that each call steps.
    pub worlds: usize,
    /// Number of threads, including the caller's; at most one for each world. Results do not depend on it.
    pub threads: usize,
    /// Seed of the worlds' random streams.
    pub seed: u64,
    /// Starts of the worlds, all with the same robot. The worlds are spread evenly over the banks, in order, and a
    /// world stays in its bank's scene: there must be at least as many worlds as banks.
    pub banks: Vec<Bank>,
    /// Forces and pushes on the robots from outside.
    pub disturbances: Disturbances,
    /// When the next episode of a world begins.
    pub autoreset: Autoreset,
    /// Exact readings besides the task's observation.
    pub watch: Watch,
}

impl BatchConfig {
    /// One world for each bank, on the caller's thread, without disturbances.
    pub fn new(banks: Vec<Bank>) -> Self {
        let (disturbances, autoreset) = (Disturbances::default(), Autoreset::default());
        let watch = Watch::default();
        Self { worlds: banks.len(), threads: 1, seed: 0, banks, disturbances, autoreset, watch }
    }

    pub(crate) fn check(&self) -> Result<(), BatchError> {
        let within = |field, found, most| match found {
            0 => Err(BatchError::Config { field, found, rule: "give at least one".into() }),
            _ if found > most => Err(BatchError::Config { field, found, rule: format!("give at most {most}") }),
            _ => Ok(()),
        };
        let starts = self.banks.iter().map(|bank| bank.starts.len());
        within("worlds", self.worlds, MAX_WORLDS)?;
        within("threads", self.threads, MAX_THREADS)?;
        within("banks", self.banks.len(), self.worlds)?;
        within("bank.starts", starts.clone().min().unwrap_or(0), MAX_STARTS)?;
        within("starts of all banks", starts.sum(), MAX_STARTS)?;
        for (bank, starts) in self.banks.iter().map(|bank| &bank.starts).enumerate() {
            let sum: f64 = starts.iter().map(|start| start.weight).sum();
            let are_weights = starts.iter().all(|start| start.weight >= 0.0) && sum > 0.0 && sum.is_finite();
            if !are_weights {
                return Err(BatchError::Weights { bank });
            }
        }
        Ok(())
    }
}
