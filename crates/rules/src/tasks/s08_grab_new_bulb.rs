//! S08 Grab New Bulb: take the fresh bulb off the bench.
//!
//! Start: the robot stands 0.63 m from the fresh bulb and faces it, hands free. The old bulb is in the crate, the
//! socket empty.

use crate::errand;
use nalgebra::Vector3;

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
    start: StartSpec {
        ladder: Ladder::Coupled,
        robot: Stand::BenchAtBulb,
        noise: ResetNoise::Usual,
        old_bulb: Spot::Crate,
        fresh_bulb: Spot::Bench,
        away_from_crate: false,
    },
    gate: Gate {
        criteria: &[
            Criterion { name: "fresh_bulb_lifted", holds: fresh_lifted },
            Criterion { name: "fresh_bulb_gripped", holds: fresh_gripped },
            Criterion { name: "fresh_bulb_handled_gently", holds: fresh_handled_gently },
            Criterion { name: "standing", holds: standing },
        ],
        sustain_steps: HALF_SECOND,
        strict: &[FRESH_GRIP, UPRIGHT],
        strict_steps: ONE_SECOND,
        goals: 1,
    },
    start_count: 2,
    also_ends_on: Causes::of(&[Cause::Drop]),
    special: SpecialRules { fresh_drop_m: |thresholds| thresholds.grab_drop_m, ..SpecialRules::NONE },
    reward: RewardSpec::Subtask {
        hints: &[
            TermSpec::new("hand_to_bulb", TOWARDS, Kind::Approach(|row, _| palm_to_bulb(row, Bulb::Fresh))),
            TermSpec::new("grip", HINT, Kind::Potential(fresh_bulb_grip)),
            FRESH_FORCE,
        ],
    },
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

/// Grows with the largest contact force on a hand body, over tens of newtons.
fn fresh_bulb_grip(row: &Row, _cx: &Context<'_>) -> f64 {
    let forces = row.force(errand::HAND_FORCE[Bulb::Fresh as usize]).iter().map(Vector3::norm);
    libm::tanh(forces.filter(|force| force.is_finite()).fold(0.0, f64::max) / 10.0)
}
