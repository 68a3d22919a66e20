//! S10 Climb with Bulb: get up the ladder with the fresh bulb in the hand.
//!
//! Start: the robot stands on the floor 0.85 m from the ladder on the side of its steps and faces it, the fresh bulb in
//! its right hand. The old bulb is in the crate, the socket empty.
//!
//! The first criterion is that of S02.

use super::bulb_criteria::{fresh_elevated, fresh_held};
use super::page::*;

pub(crate) const SPEC: TaskSpec = TaskSpec {
    short_id: "S10",
    id: "Fiatlux-S10-ClimbWithBulb-v1",
    name: "Climb with Bulb",
    instruction: "climb the ladder with the bulb in your hand",
    factors: &[Factor::Carry, Factor::Balance, Factor::Traverse],
    weight: 4.5,
    modes: &[ControlMode::Climbing, ControlMode::Manipulation],
    horizon_steps: SUBTASK_HORIZON,
    bulbs: &[Bulb::Fresh],
    start: StartSpec {
        ladder: Ladder::Coupled,
        robot: Stand::LadderSteps,
        noise: ResetNoise::AtLadder,
        old_bulb: Spot::Crate,
        fresh_bulb: Spot::Hand,
        away_from_crate: false,
    },
    gate: Gate {
        criteria: &[
            Criterion { name: "at_ladder_top", holds: at_ladder_top },
            Criterion { name: "fresh_bulb_held", holds: fresh_held },
            Criterion { name: "fresh_bulb_elevated", holds: fresh_elevated },
            Criterion { name: "standing", holds: standing },
            Criterion { name: "ladder_upright", holds: ladder_upright },
        ],
        sustain_steps: 1,
        strict: &[UP, FRESH_GRIP, UPRIGHT],
        strict_steps: ONE_SECOND,
        goals: 1,
    },
    start_count: 4,
    also_ends_on: Causes::of(&[Cause::Tip, Cause::Crush, Cause::Drop]),
    special: SpecialRules { notes_working_height: true, ..SpecialRules::NONE },
    reward: RewardSpec::Subtask { hints: &[HEIGHT_GAIN, FREE_LIMBS, FRESH_FORCE] },
};
