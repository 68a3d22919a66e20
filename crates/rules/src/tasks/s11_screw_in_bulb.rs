//! S11 Screw in Bulb: put the fresh bulb into the socket and let go.
//!
//! Start: the robot stands on the platform, facing the fixture, the fresh bulb in its right hand. The old bulb is in
//! the crate, the socket empty.

use crate::errand;
use nalgebra::Vector3;

use super::bulb_criteria::{fresh_released, fresh_seated, fresh_settled};
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
    start: StartSpec {
        ladder: Ladder::Coupled,
        robot: Stand::Platform,
        noise: ResetNoise::AtLadder,
        old_bulb: Spot::Crate,
        fresh_bulb: Spot::Hand,
        away_from_crate: false,
    },
    gate: Gate {
        criteria: &[
            Criterion { name: "fresh_bulb_seated", holds: fresh_seated },
            Criterion { name: "fresh_bulb_settled", holds: fresh_settled },
            Criterion { name: "fresh_bulb_released", holds: fresh_released },
            Criterion { name: "standing", holds: standing },
            Criterion { name: "ladder_upright", holds: ladder_upright },
        ],
        sustain_steps: ONE_SECOND,
        strict: &[UP, UPRIGHT],
        strict_steps: ONE_SECOND,
        goals: 1,
    },
    start_count: 3,
    also_ends_on: Causes::of(&[Cause::Tip, Cause::Crush, Cause::Drop]),
    special: SpecialRules::NONE,
    reward: RewardSpec::Subtask {
        hints: &[
            TermSpec::new("fresh_bulb_to_seat", TOWARDS, Kind::Approach(fresh_bulb_to_seat)),
            TermSpec::new("axis_alignment", HINT, Kind::Potential(axis_alignment)),
            FRESH_FORCE,
        ],
    },
};

/// 1 where the bulb's axis is that of the socket, falling off over tenths of a radian.
fn axis_alignment(row: &Row, _cx: &Context<'_>) -> f64 {
    let [bulb, socket] =
        [row.body(errand::FRESH_BULB).pose, row.body(errand::FIXTURE).pose].map(|pose| pose.rotation * Vector3::z());
    1.0 - libm::tanh(measure::angle_between(&bulb, &socket) / 0.3)
}
