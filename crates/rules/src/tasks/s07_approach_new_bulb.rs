//! S07 Approach New Bulb: walk up to the fresh bulb on the bench.
//!
//! Start: the robot stands next to the crate, turned towards the fresh bulb, hands free. The old bulb is in the crate,
//! the socket empty.
//!
//! 0.63 m keeps the robot clear of the bench and leaves the bulb just out of reach.

use super::page::*;
use crate::errand;

pub(crate) const SPEC: TaskSpec = TaskSpec {
    short_id: "S07",
    id: "Fiatlux-S07-ApproachNewBulb-v1",
    name: "Approach New Bulb",
    instruction: "walk up to the bulb on the table",
    factors: &[],
    weight: 1.0,
    modes: &[ControlMode::FlatNavigation],
    horizon_steps: SUBTASK_HORIZON,
    bulbs: &[],
    start: StartSpec {
        ladder: Ladder::Coupled,
        robot: Stand::Beside { landmark: Landmark::Crate, distance: StartDistance::Leave, facing: Landmark::FreshBulb },
        noise: ResetNoise::Usual,
        old_bulb: Spot::Crate,
        fresh_bulb: Spot::Bench,
        away_from_crate: false,
    },
    gate: Gate {
        criteria: &[
            Criterion { name: "near_fresh_bulb", holds: near_fresh },
            Criterion { name: "facing_fresh_bulb", holds: facing_fresh },
            Criterion { name: "walking_slowly", holds: walks_slowly },
        ],
        sustain_steps: 1,
        strict: &[SLOW, STANDING, UPRIGHT],
        strict_steps: ONE_SECOND,
        goals: 1,
    },
    start_count: 2,
    also_ends_on: Causes::NONE,
    special: SpecialRules::NONE,
    reward: RewardSpec::Subtask {
        hints: &[TermSpec::new("robot_to_bulb", TOWARDS, Kind::Approach(robot_to_fresh_bulb))],
    },
};

fn near_fresh(row: &Row, cx: &Context<'_>) -> bool {
    robot_distance(row, &row.body(errand::FRESH_BULB).pose.translation.vector) < cx.thresholds.bench_near_m
}

fn facing_fresh(row: &Row, cx: &Context<'_>) -> bool {
    faces(row, cx, &row.body(errand::FRESH_BULB).pose.translation.vector)
}

fn robot_to_fresh_bulb(row: &Row, _cx: &Context<'_>) -> f64 {
    robot_distance(row, &row.body(errand::FRESH_BULB).pose.translation.vector)
}
