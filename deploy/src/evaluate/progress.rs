//! How far an evaluation is.

use fiatlux_rules::Task;

/// A look at an evaluation under way.
#[derive(Debug, Clone, PartialEq)]
pub struct Progress {
    /// Episodes of the evaluation in all.
    pub episodes: usize,
    /// Episodes that are finished.
    pub finished: usize,
    /// Control steps so far.
    pub steps: u64,
    /// Most steps that could still follow: every episode goes on to its horizon.
    pub steps_left: u64,
    /// What is being played: task, seed and step.
    pub playing: Vec<(Task, u64, u64)>,
}
