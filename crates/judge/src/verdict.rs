//! The verdict on the rows of an episode, and its end.

use serde::{Deserialize, Serialize};

use crate::cause::{Cause, Causes};
use crate::gate::Criteria;

/// The end of an episode.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct End {
    /// The row that ended it.
    pub step: u64,
    /// All conditions in force that this row met.
    pub causes: Causes,
}

impl End {
    /// The cause to name: success or divergence if it is among them; time-out only if it is the only one.
    pub fn cause(&self) -> Cause {
        self.causes.iter().next().unwrap_or(Cause::TimeOut)
    }

    /// True if a success or a failure ended it.
    pub fn is_terminated(&self) -> bool {
        !self.is_truncated()
    }

    /// True if only the time-out ended it.
    pub fn is_truncated(&self) -> bool {
        self.cause() == Cause::TimeOut
    }
}

/// The verdict on the rows up to one.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Verdict {
    /// Step of the last row that was judged.
    pub step: u64,
    /// Criteria of the gate in this row.
    pub criteria: Criteria,
    /// Number of criteria that hold in this row.
    pub count: u32,
    /// Largest number that held in any row.
    pub best_count: u32,
    /// `clamp((best - c0) / (n - c0), 0, 1)`, and 1 where c0 is n.
    pub progress: f64,
    /// Consecutive rows, up to this one, in which all held.
    pub sustained: u32,
    /// The gate has held for its window, in this row or earlier, and no row has diverged.
    pub success: bool,
    /// Conditions that this row meets, in force or not; success only in the row that completes its window.
    pub conditions: Causes,
    /// Something broke, in this row or earlier.
    pub broken: bool,
    /// Something was dropped that must not be, in this row or earlier.
    pub dropped: bool,
    /// The robot rose or sank faster than anybody climbs, in this row or earlier; only protocol `strict` uses it.
    pub leapt: bool,
    /// The pelvis was at working height, in this row or earlier; a diagnostic.
    pub reached_working_height: bool,
    /// Largest contact force of what is handled on a hand body so far, N.
    pub peak_hand_force_n: f64,
    /// The same over all physics steps, N; a diagnostic.
    pub peak_substep_force_n: f64,
    /// The end, once there is one.
    pub end: Option<End>,
}

impl Verdict {
    /// The verdict before any row.
    pub(crate) const UNJUDGED: Self = Self {
        step: 0,
        criteria: Criteria::NONE,
        count: 0,
        best_count: 0,
        progress: 0.0,
        sustained: 0,
        success: false,
        conditions: Causes::NONE,
        broken: false,
        dropped: false,
        leapt: false,
        reached_working_height: false,
        peak_hand_force_n: 0.0,
        peak_substep_force_n: 0.0,
        end: None,
    };
}
