//! What the rows of an episode say, and how it ended.

use crate::cause::{Cause, Causes};
use crate::gate::Criteria;

/// How an episode ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct End {
    /// The row that ended it.
    pub step: u64,
    /// All conditions in force that this row met.
    pub causes: Causes,
}

impl End {
    /// The cause to name: success or a divergence where it is among them, the time-out only where it is alone.
    pub fn cause(&self) -> Cause {
        self.causes.iter().next().unwrap_or(Cause::TimeOut)
    }

    /// Ended by a success or a failure.
    pub fn is_terminated(&self) -> bool {
        !self.is_truncated()
    }

    /// Ended by the time-out alone.
    pub fn is_truncated(&self) -> bool {
        self.cause() == Cause::TimeOut
    }
}

/// What the rows up to one say.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Verdict {
    /// Step of the last row that was judged.
    pub step: u64,
    /// Criteria of the gate in this row.
    pub criteria: Criteria,
    /// How many hold in this row.
    pub count: u32,
    /// The most that held in any row.
    pub best_count: u32,
    /// `clamp((best - c0) / (n - c0), 0, 1)`, and 1 where c0 is n.
    pub progress: f64,
    /// Consecutive rows, up to this one, in which all held.
    pub sustained: u32,
    /// The gate has held for its window, in this row or before, and no row has diverged.
    pub success: bool,
    /// Conditions that this row meets, in force or not; success only in the row that completes its window.
    pub conditions: Causes,
    /// A bulb pressed harder on a hand body than it can bear, in this row or before.
    pub broken: bool,
    /// A bulb was dropped, in this row or before.
    pub dropped: bool,
    /// The robot rose or sank faster than anybody climbs, in this row or before; only protocol `strict` minds.
    pub leapt: bool,
    /// The pelvis was at working height, in this row or before; a diagnostic.
    pub reached_working_height: bool,
    /// Largest contact force of a bulb on a hand body so far, N.
    pub peak_hand_force_n: f64,
    /// The same over all physics steps; a diagnostic.
    pub peak_substep_force_n: f64,
    /// How the episode ended, once it has.
    pub end: Option<End>,
}
