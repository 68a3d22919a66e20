//! How far an evaluation is.

use std::fmt;
use std::time::Duration;

use fiatlux_rules::Task;

/// A look at an evaluation under way.
#[derive(Debug, Clone, PartialEq)]
pub struct Progress {
    /// Episodes to play.
    pub episodes: usize,
    /// Episodes finished.
    pub finished: usize,
    /// Control steps so far.
    pub steps: u64,
    /// Time since the start.
    pub elapsed: Duration,
    /// Most steps that could still follow.
    pub steps_left: u64,
    /// What is being played: task, seed and step.
    pub playing: Vec<(Task, u64, u64)>,
}

impl Progress {
    /// Control steps a second so far.
    pub fn steps_per_s(&self) -> f64 {
        self.steps as f64 / self.elapsed.as_secs_f64().max(1e-3)
    }

    /// Time left if every episode goes on to its horizon; most end earlier.
    pub fn most_time_left(&self) -> Duration {
        Duration::from_secs_f64(self.steps_left as f64 / self.steps_per_s().max(1.0))
    }
}

impl fmt::Display for Progress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (left, rate) = (self.most_time_left().as_secs(), self.steps_per_s());
        write!(
            f,
            "{}/{} episodes, {rate:.0} steps/s, at most {}:{:02} left",
            self.finished,
            self.episodes,
            left / 60,
            left % 60
        )?;
        for (task, seed, step) in &self.playing {
            write!(f, "  {task}/{seed} at {:.0} s", *step as f64 * fiatlux_rules::CONTROL_DT)?;
        }
        Ok(())
    }
}
