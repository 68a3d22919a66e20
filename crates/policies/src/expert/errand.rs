//! The errand in one piece: which subtask is due, by what is the case.

use fiatlux_client::PolicyError;
use fiatlux_proto::v3::Observation;
use fiatlux_room::{crate_, ladder};
use fiatlux_rules::{Bulb, Task, Thresholds};
use nalgebra::{Isometry3, Vector3};

use crate::body::pose;

/// The state of the room, as far as a choice depends on it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Facts {
    /// The ladder stands below the fixture, as the rulebook asks in S01.
    pub ladder_is_placed: bool,
    /// The robot is where it works: on the platform.
    pub is_up: bool,
    pub old_is_seated: bool,
    pub fresh_is_seated: bool,
    /// The bulb in a hand.
    pub holds: Option<Bulb>,
    /// The old bulb is in the crate.
    pub is_disposed: bool,
    pub at_crate: bool,
    pub at_bench: bool,
    pub at_ladder: bool,
}

type Condition = fn(&Facts) -> bool;

/// The errand: the first subtask of this table whose condition holds is due; with none, the robot stands.
const TABLE: [(Task, Condition); 12] = [
    (Task::S12, |is| is.is_up && is.holds.is_none() && !is.old_is_seated),
    (Task::S11, |is| is.is_up && is.holds == Some(Bulb::Fresh)),
    (Task::S04, |is| is.is_up && is.holds == Some(Bulb::Old)),
    (Task::S03, |is| is.is_up && is.old_is_seated),
    (Task::S06, |is| is.holds == Some(Bulb::Old) && is.at_crate),
    (Task::S05, |is| is.holds == Some(Bulb::Old)),
    (Task::S10, |is| is.holds == Some(Bulb::Fresh) && is.at_ladder),
    (Task::S09, |is| is.holds == Some(Bulb::Fresh)),
    (Task::S01, |is| is.old_is_seated && !is.ladder_is_placed),
    (Task::S02, |is| is.old_is_seated),
    (Task::S08, |is| !is.fresh_is_seated && is.at_bench),
    (Task::S07, |is| !is.fresh_is_seated),
];

impl Facts {
    /// The subtask that is due.
    pub fn due(&self) -> Option<Task> {
        TABLE.into_iter().find(|(_, is_due)| is_due(self)).map(|(task, _)| task)
    }

    /// Reads them off an observation. `touches`: a hand has felt a bulb within the last moments.
    pub fn of(observation: &Observation, touches: bool) -> Result<Self, PolicyError> {
        let seen = observation.privileged.as_ref();
        let seen = seen.ok_or(PolicyError::Sensor { policy: "expert", sensor: "privileged" })?;
        let read = |of| pose("expert", of);
        let (robot, ladder, socket) =
            (read(seen.robot.as_ref())?, read(seen.ladder.as_ref())?, read(seen.socket.as_ref())?);
        let (old, fresh) = (read(seen.old_bulb.as_ref())?, read(seen.fresh_bulb.as_ref())?);
        let crate_ = read(seen.crate_.as_ref())?;
        let [old_is_seated, fresh_is_seated] = [0, 1].map(|bulb| seen.seated.get(bulb).copied().unwrap_or_default());
        let is_disposed = !old_is_seated && outside(&crate_, &old) <= 0.0 && old.translation.z < CRATE_HEIGHT;
        let is_high = |bulb: &Isometry3<f64>| bulb.translation.z > HELD_HEIGHT;
        let holds = if touches && !old_is_seated && is_high(&old) {
            Some(Bulb::Old)
        } else {
            (touches && !fresh_is_seated && is_high(&fresh)).then_some(Bulb::Fresh)
        };
        let top = ladder * nalgebra::Point3::from(LADDER_TOP);
        let is_upright = (ladder.rotation * Vector3::z()).z > libm::cos(MAX_LEAN);
        Ok(Self {
            ladder_is_placed: is_upright
                && (top.coords - socket.translation.vector).xy().norm() < Thresholds::default().placement_m,
            is_up: robot.translation.z > UP,
            old_is_seated,
            fresh_is_seated,
            holds,
            is_disposed,
            at_crate: outside(&crate_, &robot) < AT_CRATE,
            at_bench: level(&robot, &fresh) < AT_BENCH,
            at_ladder: level(&robot, &ladder) < AT_LADDER,
        })
    }
}

/// Half extents of the crate, outside, and a height above its rim, m.
const CRATE_HALF: [f64; 2] = crate_::OUTER_HALF;
const CRATE_HEIGHT: f64 = 0.25;
/// The ladder's top point in its frame, m.
const LADDER_TOP: [f64; 3] = ladder::TOP_POINT;
/// Height of the pelvis above the floor from which on the robot is on the platform, even if it leans as low as `hands` does, m.
const UP: f64 = 1.6;
/// Lean at which the ladder is not ready, rad.
const MAX_LEAN: f64 = 0.1;
/// Height of a bulb above which a hand has it, m: drop heights are below.
const HELD_HEIGHT: f64 = 0.3;
/// Distances of the pelvis at which walks end, from the crate's sides, from the bulb and from the ladder, m: those of the gates, and
/// what a robot that sways needs.
const AT_CRATE: f64 = 0.53;
const AT_BENCH: f64 = 0.66;
const AT_LADDER: f64 = 0.88;

/// Distance over the floor from the sides of the crate, m; at most 0 inside.
fn outside(crate_: &Isometry3<f64>, there: &Isometry3<f64>) -> f64 {
    let at = crate_.inverse_transform_point(&there.translation.vector.into());
    let [x, y] = [at.x.abs() - CRATE_HALF[0], at.y.abs() - CRATE_HALF[1]];
    if x <= 0.0 && y <= 0.0 { x.max(y) } else { libm::hypot(x.max(0.0), y.max(0.0)) }
}

fn level(here: &Isometry3<f64>, there: &Isometry3<f64>) -> f64 {
    (here.translation.vector - there.translation.vector).xy().norm()
}

#[cfg(test)]
mod tests {
    use super::*;

    const BEGINS: Facts = Facts {
        ladder_is_placed: false,
        is_up: false,
        old_is_seated: true,
        fresh_is_seated: false,
        holds: None,
        is_disposed: false,
        at_crate: false,
        at_bench: false,
        at_ladder: false,
    };

    /// The whole errand in the order of the subtasks, each from what the one before leaves.
    #[test]
    fn what_a_subtask_leaves_makes_the_next_one_due() {
        let mut is = BEGINS;
        type Change = fn(&mut Facts);
        let changes: [(Task, Change); 12] = [
            (Task::S01, |is| is.ladder_is_placed = true),
            (Task::S02, |is| (is.is_up, is.at_ladder) = (true, true)),
            (Task::S03, |is| (is.old_is_seated, is.holds) = (false, Some(Bulb::Old))),
            (Task::S04, |is| is.is_up = false),
            (Task::S05, |is| (is.at_crate, is.at_ladder) = (true, false)),
            (Task::S06, |is| (is.holds, is.is_disposed) = (None, true)),
            (Task::S07, |is| (is.at_bench, is.at_crate) = (true, false)),
            (Task::S08, |is| is.holds = Some(Bulb::Fresh)),
            (Task::S09, |is| (is.at_ladder, is.at_bench) = (true, false)),
            (Task::S10, |is| is.is_up = true),
            (Task::S11, |is| (is.fresh_is_seated, is.holds) = (true, None)),
            (Task::S12, |is| is.is_up = false),
        ];
        for (task, changes) in changes {
            assert_eq!(is.due(), Some(task));
            changes(&mut is);
        }
        assert_eq!(is.due(), None);
    }

    /// A mishap is mended from where it is, and not from the start.
    #[test]
    fn a_setback_makes_an_earlier_subtask_due() {
        let up = Facts { is_up: true, ladder_is_placed: true, ..BEGINS };
        assert_eq!(up.due(), Some(Task::S03));
        assert_eq!(Facts { ladder_is_placed: false, is_up: false, ..up }.due(), Some(Task::S01));
        let carries = Facts { holds: Some(Bulb::Fresh), old_is_seated: false, is_disposed: true, ..BEGINS };
        assert_eq!(carries.due(), Some(Task::S09));
        assert_eq!(Facts { holds: None, at_bench: true, ..carries }.due(), Some(Task::S08));
    }
}
