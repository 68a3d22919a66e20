//! S06 Dispose Bulb: put the spent bulb into the crate and let go.
//!
//! Start: the robot stands 0.5 m from the crate's centre and faces it, the old bulb in its right hand. The socket is
//! empty, the fresh bulb on the bench.
//!
//! Strict, the robot still stands a second after the gate has held for one. Thrown from where it stands, the bulb falls at 2.9 m/s,
//! which breaks it; from a crouch, at 1.3.

use super::bulb_criteria::{old_at_rest, old_released};
use super::page::*;
use crate::errand;

pub(crate) const SPEC: TaskSpec = TaskSpec {
    short_id: "S06",
    id: "Fiatlux-S06-DisposeBulb-v1",
    name: "Dispose Bulb",
    instruction: "lower the bulb into the yellow crate and release it",
    factors: &[Factor::Release],
    weight: 1.8,
    modes: &[ControlMode::Manipulation],
    horizon_steps: SUBTASK_HORIZON,
    bulbs: &[Bulb::Old],
    start: StartSpec {
        ladder: Ladder::Coupled,
        robot: Stand::Beside { landmark: Landmark::Crate, distance: StartDistance::Dispose, facing: Landmark::Crate },
        noise: ResetNoise::Usual,
        old_bulb: Spot::Hand,
        fresh_bulb: Spot::Bench,
        away_from_crate: false,
    },
    gate: Gate {
        criteria: &[
            Criterion { name: "old_bulb_in_crate", holds: old_in_crate },
            Criterion { name: "old_bulb_at_rest", holds: old_at_rest },
            Criterion { name: "old_bulb_released", holds: old_released },
            Criterion { name: "standing", holds: standing },
        ],
        sustain_steps: ONE_SECOND,
        strict: &[DOWN, UPRIGHT],
        strict_steps: 2 * ONE_SECOND,
        goals: 1,
    },
    start_count: 2,
    also_ends_on: Causes::of(&[Cause::Crush]),
    special: SpecialRules::NONE,
    reward: RewardSpec::Subtask { hints: &[TermSpec::new("bulb_to_crate", TOWARDS, Kind::Approach(bulb_to_crate))] },
};

fn old_in_crate(row: &Row, cx: &Context<'_>) -> bool {
    in_crate(row, cx, Bulb::Old)
}

fn bulb_to_crate(row: &Row, _cx: &Context<'_>) -> f64 {
    (row.body(errand::OLD_BULB).pose.translation.vector - row.body(errand::CRATE).pose.translation.vector).norm()
}
