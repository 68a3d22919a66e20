//! Measurements of a row that do not depend on the protocol: made once, used by both judges.

use fiatlux_judge::{Cause, Causes};
use serde::{Deserialize, Serialize};

use crate::bulb_motion::BulbMotion;
use crate::context::Context;
use crate::divergence::diverged;
use crate::errand;
use crate::measure;
use crate::parts::Bulb;
use crate::predicates::{at_working_height, crushed, dropped, fallen, ladder_tipped, seated};
use crate::row::Row;
use crate::settle::PoseSpeed;
use crate::spec::TaskSpec;
use crate::strict::leaps;

/// Measurements of a row, in part relative to earlier rows.
#[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
pub(crate) struct Evidence {
    /// Number of the row.
    pub step: u64,
    /// This is the number of the row before plus 1.
    pub follows: bool,
    /// Low-passed speeds of the bulbs.
    pub bulb_speeds: [PoseSpeed; 2],
    /// The same in the frames of the palms, by bulb, then left and right, m/s.
    pub grip_speeds: [[f64; 2]; 2],
    /// Conditions that it meets. Success is never among them: it follows from the rows before and the protocol.
    pub conditions: Causes,
    /// A bulb is dropped in a task that forbids it, even if this does not end the episode.
    pub drops: bool,
    /// Something struck a bulb, except in the first rows.
    pub has_blow: bool,
    /// The robot rises or sinks faster than anybody climbs.
    pub leaps: bool,
    /// The pelvis is at working height.
    pub is_high: bool,
    /// Largest contact force of a bulb on a hand body, N.
    pub hand_force_n: f64,
    /// Largest contact force of a bulb on a hand body over the physics steps, N.
    pub substep_force_n: f64,
    /// Largest force of anything on a bulb over the physics steps, N.
    pub bulb_force_n: f64,
    /// Sum of the action's squares.
    pub squared_action: f64,
}

impl Evidence {
    /// Measures a row, `steps` after the start, and takes the bulbs' motion on to it.
    pub fn of(
        row: &Row,
        follows: bool,
        steps: u64,
        motion: &mut BulbMotion,
        spec: &TaskSpec,
        cx: &Context<'_>,
    ) -> Self {
        let thresholds = cx.thresholds;
        let hand_peaks = errand::HAND_FORCE_PEAK.map(|peak| measure::largest(row.load(peak).iter().copied()));
        let bulb_peaks =
            [0, 1].map(|bulb| measure::largest([hand_peaks[bulb], row.load(errand::OTHER_FORCE_PEAK[bulb])[0]]));
        let impacts = motion.advance(row, bulb_peaks.map(|peak| peak > 0.0), steps, thresholds);
        let parked = spec.special.bulbs_parked;
        let drops = Bulb::ALL.map(|bulb| (!parked || spec.bulbs.contains(&bulb)) && dropped(row, cx, bulb));
        let any_of_task = |holds: &dyn Fn(Bulb) -> bool| spec.bulbs.iter().any(|bulb| holds(*bulb));
        let meets = |cause| match cause {
            Cause::Success => false,
            Cause::Diverged => diverged(row),
            Cause::Fall => fallen(row, cx),
            Cause::Tip => ladder_tipped(row, cx),
            Cause::Crush => {
                steps > u64::from(thresholds.crush_exempt_rows) && any_of_task(&|bulb| crushed(row, cx, bulb))
            }
            Cause::Drop => any_of_task(&|bulb| drops[bulb as usize]),
            Cause::Unseated => spec.special.keeps_seated.is_some_and(|bulb| !seated(row, bulb)),
            Cause::Impact => impacts.impact,
            Cause::TimeOut => steps >= spec.horizon_steps,
        };
        Self {
            step: row.step,
            follows,
            bulb_speeds: motion.speeds,
            grip_speeds: motion.grip_speeds,
            conditions: Cause::ALL.into_iter().filter(|cause| meets(*cause)).collect(),
            drops: !parked && drops.contains(&true),
            has_blow: impacts.blow,
            leaps: leaps(row, cx),
            is_high: at_working_height(row, cx),
            hand_force_n: measure::largest(errand::HAND_FORCE.map(|force| measure::largest_norm(row.force(force)))),
            substep_force_n: measure::largest(hand_peaks),
            bulb_force_n: measure::largest(bulb_peaks),
            squared_action: row.action.iter().map(|a| a * a).sum(),
        }
    }
}
