//! S04 Descend with Bulb: climb down with the spent bulb in the hand.
//!
//! Start: the robot stands on the platform, facing the fixture, the old bulb in its right hand. The socket is empty,
//! the fresh bulb on the bench.
//!
//! The gate's place is within 0.6 m of the ladder, nearer than where S02 starts: the robot is still next to the lowest
//! tread, or next to the ladder.

use super::bulb_criteria::{old_elevated, old_held};
use super::page::*;

pub(crate) const SPEC: TaskSpec = TaskSpec {
    short_id: "S04",
    id: "Fiatlux-S04-DescendWithBulb-v1",
    name: "Descend with Bulb",
    instruction: "climb down the ladder with the bulb in your hand",
    factors: &[Factor::Carry, Factor::Balance, Factor::Traverse],
    weight: 4.5,
    modes: &[ControlMode::Climbing, ControlMode::Manipulation],
    horizon_steps: SUBTASK_HORIZON,
    bulbs: &[Bulb::Old],
    start: StartSpec {
        ladder: Ladder::Coupled,
        robot: Stand::Platform,
        noise: ResetNoise::AtLadder,
        old_bulb: Spot::Hand,
        fresh_bulb: Spot::Bench,
        away_from_crate: false,
    },
    gate: Gate {
        criteria: &[
            Criterion { name: "at_ladder_foot", holds: at_ladder_foot },
            Criterion { name: "old_bulb_held", holds: old_held },
            Criterion { name: "old_bulb_elevated", holds: old_elevated },
            Criterion { name: "standing", holds: standing },
            Criterion { name: "ladder_upright", holds: ladder_upright },
        ],
        sustain_steps: 1,
        strict: &[DOWN, OLD_GRIP, UPRIGHT],
        strict_steps: ONE_SECOND,
        goals: 1,
    },
    start_count: 4,
    also_ends_on: Causes::of(&[Cause::Tip, Cause::Crush, Cause::Drop]),
    special: SpecialRules::NONE,
    reward: RewardSpec::Subtask { hints: &[DESCENT, FREE_LIMBS, OLD_FORCE] },
};
