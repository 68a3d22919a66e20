//! S08 Grab New Bulb: take the fresh bulb off the bench.
//!
//! Start: the robot stands 0.63 m from the fresh bulb and faces it, hands free. The old bulb is in the crate, the
//! socket empty.

use super::page::*;

pub(crate) const SPEC: TaskSpec = TaskSpec {
    short_id: "S08",
    id: "Fiatlux-S08-GrabNewBulb-v1",
    name: "Grab New Bulb",
    instruction: "pick up the bulb from the table",
    factors: &[Factor::Grasp],
    weight: 1.4,
    modes: &[ControlMode::Manipulation],
    horizon_steps: SUBTASK_HORIZON,
    bulbs: &[Bulb::Fresh],
    gate: Gate {
        criteria: &[
            Criterion { name: "fresh_bulb_lifted", holds: fresh_lifted },
            Criterion { name: "fresh_bulb_gripped", holds: fresh_gripped },
            Criterion { name: "fresh_bulb_handled_gently", holds: fresh_handled_gently },
            Criterion { name: "standing", holds: standing },
        ],
        sustain_steps: HALF_SECOND,
    },
    start_count: 2,
    also_ends_on: Causes::of(&[Cause::Drop]),
};

fn fresh_lifted(row: &Row, cx: &Context<'_>) -> bool {
    lifted(row, cx, Bulb::Fresh)
}

fn fresh_gripped(row: &Row, cx: &Context<'_>) -> bool {
    gripped(row, cx, Bulb::Fresh)
}

fn fresh_handled_gently(row: &Row, cx: &Context<'_>) -> bool {
    handled_gently(row, cx, Bulb::Fresh)
}
