//! S09 Carry Bulb to Ladder: walk to the ladder with the fresh bulb in the hand.
//!
//! Start: the robot stands clear of the bench, turned towards the ladder, the fresh bulb in its right hand. The old
//! bulb is in the crate, the socket empty.

use super::bulb_criteria::fresh_held;
use super::page::*;
use crate::errand;

pub(crate) const SPEC: TaskSpec = TaskSpec {
    short_id: "S09",
    id: "Fiatlux-S09-CarryBulbToLadder-v1",
    name: "Carry Bulb to Ladder",
    instruction: "carry the bulb over to the ladder",
    factors: &[Factor::Carry],
    weight: 1.5,
    modes: &[ControlMode::FlatNavigation],
    horizon_steps: SUBTASK_HORIZON,
    bulbs: &[Bulb::Fresh],
    start: StartSpec {
        ladder: Ladder::Coupled,
        robot: Stand::BenchFacing(Landmark::Ladder),
        noise: ResetNoise::None,
        old_bulb: Spot::Crate,
        fresh_bulb: Spot::Hand,
        away_from_crate: false,
    },
    gate: Gate {
        criteria: &[
            Criterion { name: "near_ladder", holds: near_ladder },
            Criterion { name: "facing_ladder", holds: facing_ladder },
            Criterion { name: "walking_slowly", holds: walks_slowly },
            Criterion { name: "fresh_bulb_held", holds: fresh_held },
            Criterion { name: "ladder_upright", holds: ladder_upright },
        ],
        sustain_steps: 1,
        strict: &[SLOW, STANDING, FRESH_GRIP, UPRIGHT],
        strict_steps: ONE_SECOND,
        goals: 1,
    },
    start_count: 4,
    also_ends_on: Causes::of(&[Cause::Tip, Cause::Crush]),
    special: SpecialRules::NONE,
    reward: RewardSpec::Subtask { hints: &[ROBOT_TO_LADDER] },
};

fn near_ladder(row: &Row, cx: &Context<'_>) -> bool {
    robot_distance(row, &row.body(errand::LADDER).pose.translation.vector) < cx.thresholds.mounting_m
}

fn facing_ladder(row: &Row, cx: &Context<'_>) -> bool {
    faces(row, cx, &row.body(errand::LADDER).pose.translation.vector)
}
