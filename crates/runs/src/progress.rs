//! Progress of an evaluation.

use fiatlux_rules::Task;

/// A snapshot of an evaluation in progress.
#[derive(Debug, Clone, PartialEq)]
pub struct Progress {
    /// Number of episodes in the evaluation.
    pub episodes: usize,
    /// Number of finished episodes.
    pub finished: usize,
    /// Control steps played so far.
    pub steps: u64,
    /// Largest number of steps still to come, if every episode goes on to its horizon.
    pub steps_left: u64,
    /// Task, seed and current step of each episode that is being played.
    pub playing: Vec<(Task, u64, u64)>,
}
