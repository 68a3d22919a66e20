//! S11 Screw in Bulb: put the fresh bulb into the socket and let go.
//!
//! Start: the robot stands on the platform, facing the fixture, the fresh bulb in its right hand. The old bulb is in
//! the crate, the socket empty.

use super::bulb_criteria::{fresh_released, fresh_seated};
use super::page::*;

pub(crate) const SPEC: TaskSpec = TaskSpec {
    short_id: "S11",
    id: "Fiatlux-S11-ScrewInBulb-v1",
    name: "Screw in Bulb",
    instruction: "insert the bulb into the lamp fixture",
    factors: &[Factor::Release, Factor::Balance, Factor::Mate],
    weight: 5.4,
    modes: &[ControlMode::Manipulation, ControlMode::Climbing],
    horizon_steps: SUBTASK_HORIZON,
    bulbs: &[Bulb::Fresh],
    gate: Gate {
        criteria: &[
            Criterion { name: "fresh_bulb_seated", holds: fresh_seated },
            Criterion { name: "fresh_bulb_settled", holds: fresh_settled },
            Criterion { name: "fresh_bulb_released", holds: fresh_released },
            Criterion { name: "standing", holds: standing },
            Criterion { name: "ladder_upright", holds: ladder_upright },
        ],
        sustain_steps: ONE_SECOND,
    },
    start_count: 3,
    also_ends_on: Causes::of(&[Cause::Tip, Cause::Crush, Cause::Drop]),
};

fn fresh_settled(_row: &Row, cx: &Context<'_>) -> bool {
    settled(cx, Bulb::Fresh)
}
