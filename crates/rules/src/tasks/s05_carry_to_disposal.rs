//! S05 Carry Bulb to Disposal: walk to the crate with the spent bulb in the hand.
//!
//! Start: the robot stands 0.85 m from the ladder or nearer, turned towards the crate, the old bulb in its right hand.
//! The socket is empty, the fresh bulb on the bench.

use super::bulb_criteria::old_held;
use super::page::*;
use crate::errand;

pub(crate) const SPEC: TaskSpec = TaskSpec {
    short_id: "S05",
    id: "Fiatlux-S05-CarryBulbToDisposal-v1",
    name: "Carry Bulb to Disposal",
    instruction: "carry the bulb over to the yellow crate",
    factors: &[Factor::Carry],
    weight: 1.5,
    modes: &[ControlMode::FlatNavigation],
    horizon_steps: SUBTASK_HORIZON,
    bulbs: &[Bulb::Old],
    start: StartSpec {
        ladder: Ladder::Coupled,
        robot: Stand::Beside { landmark: Landmark::Ladder, distance: StartDistance::Mounting, facing: Landmark::Crate },
        noise: ResetNoise::None,
        old_bulb: Spot::Hand,
        fresh_bulb: Spot::Bench,
        away_from_crate: true,
    },
    gate: Gate {
        criteria: &[
            Criterion { name: "near_crate", holds: near_crate },
            Criterion { name: "facing_crate", holds: facing_crate },
            Criterion { name: "walking_slowly", holds: walks_slowly },
            Criterion { name: "old_bulb_held", holds: old_held },
        ],
        sustain_steps: 1,
        strict: &[SLOW, STANDING, OLD_GRIP, UPRIGHT],
        strict_steps: ONE_SECOND,
        goals: 1,
    },
    start_count: 3,
    also_ends_on: Causes::of(&[Cause::Crush]),
    special: SpecialRules::NONE,
    reward: RewardSpec::Subtask { hints: &[TermSpec::new("robot_to_crate", TOWARDS, Kind::Approach(robot_to_crate))] },
};

fn near_crate(row: &Row, cx: &Context<'_>) -> bool {
    let half = &cx.geometry.crate_outer_half;
    measure::footprint_distance(&row.body(errand::CRATE).pose, half, &row.robot.pose.translation.vector)
        < cx.thresholds.crate_near_m
}

fn facing_crate(row: &Row, cx: &Context<'_>) -> bool {
    faces(row, cx, &row.body(errand::CRATE).pose.translation.vector)
}

fn robot_to_crate(row: &Row, _cx: &Context<'_>) -> f64 {
    robot_distance(row, &row.body(errand::CRATE).pose.translation.vector)
}
