//! From judged episodes to the benchmark's score.

mod benchmark;
mod rate;

use crate::task::Task;
use crate::verdict::End;

pub use benchmark::{Benchmark, SeedScore, Spread, SubtaskScore};
pub use rate::{Rate, wilson_interval};

/// Summary of one episode.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Summary {
    /// The task that was played.
    pub task: Task,
    /// Whether the gate fired: it held for its whole window.
    pub success: bool,
    /// Whether a bulb pressed harder on a hand body than it can bear.
    pub broken: bool,
    /// Whether a bulb was dropped.
    pub dropped: bool,
    /// Gate progress, from 0 to 1.
    pub gate_progress: f64,
    /// Largest contact force of a bulb on a hand body, N.
    pub peak_hand_force_n: f64,
    /// Mean over the steps of the sum of squared actions.
    pub control_effort: f64,
    /// Control steps that were played.
    pub steps: u64,
    /// How it ended; `None` while it runs or if it was cut.
    pub end: Option<End>,
    /// Whether the pelvis was at working height; a diagnostic.
    pub reached_working_height: bool,
}

impl Summary {
    /// Success with nothing broken and nothing dropped.
    pub fn clean(&self) -> bool {
        self.success && !self.broken && !self.dropped
    }

    /// `max(0, success - broken - dropped)`.
    pub fn score(&self) -> f64 {
        f64::from(u8::from(self.clean()))
    }
}

/// An episode of the benchmark.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Episode {
    /// Seed of the layout.
    pub seed: u64,
    /// Summary of the episode.
    pub summary: Summary,
}
