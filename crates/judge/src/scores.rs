//! From judged episodes to the benchmark's score.

mod benchmark;
mod rate;

use crate::verdict::End;

pub use benchmark::{Benchmark, SeedScore, Spread, SubtaskScore};
pub use rate::{Rate, wilson_interval};

/// A task as scores see it.
pub trait ScoredTask: Copy + PartialEq + 'static {
    /// All tasks, in the order of results.
    const ALL: &'static [Self];

    /// Weight in the benchmark's score; 0 for a task outside of it.
    fn weight(self) -> f64;
}

/// Summary of one episode.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Summary<T> {
    /// The task that was played.
    pub task: T,
    /// The gate fired: it held for its whole window.
    pub success: bool,
    /// Something broke.
    pub broken: bool,
    /// Something was dropped that must not be.
    pub dropped: bool,
    /// Gate progress, from 0 to 1.
    pub gate_progress: f64,
    /// Largest contact force of what is handled on a hand body, N.
    pub peak_hand_force_n: f64,
    /// Mean over the steps of the sum of squared actions.
    pub control_effort: f64,
    /// Control steps that were played.
    pub steps: u64,
    /// The end; `None` while the episode runs or if it was cut.
    pub end: Option<End>,
    /// The pelvis was at working height; a diagnostic.
    pub reached_working_height: bool,
}

impl<T> Summary<T> {
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
pub struct Episode<T> {
    /// Seed of the layout.
    pub seed: u64,
    /// Summary of the episode.
    pub summary: Summary<T>,
}
