//! Climb: up to working height, in a scene with a fixed ladder and no bulb in play.
//!
//! Start: the robot stands on the floor 0.85 m from the ladder and faces it.
//!
//! Unlike S02, its gate needs the platform: the pelvis above 1.82 m.

use super::page::*;
use crate::errand;

pub(crate) const SPEC: TaskSpec = TaskSpec {
    short_id: "climb",
    id: "Fiatlux-Climb-v1",
    name: "Climb",
    instruction: "climb the ladder up to its platform",
    factors: &[],
    weight: 0.0,
    modes: &[ControlMode::Climbing],
    horizon_steps: SUBTASK_HORIZON,
    bulbs: &[],
    start: StartSpec {
        ladder: Ladder::Fixed,
        robot: Stand::OwnZone,
        noise: ResetNoise::Usual,
        old_bulb: Spot::Parked,
        fresh_bulb: Spot::Parked,
        away_from_crate: false,
    },
    gate: Gate {
        criteria: &[
            Criterion { name: "at_working_height", holds: at_working_height },
            Criterion { name: "near_ladder", holds: near_ladder },
            Criterion { name: "climbing_slowly", holds: climbs_slowly },
        ],
        sustain_steps: 1,
        strict: &[UP, UPRIGHT],
        strict_steps: ONE_SECOND,
        goals: 1,
    },
    start_count: 1,
    also_ends_on: Causes::NONE,
    special: SpecialRules { bulbs_parked: true, ..SpecialRules::NONE },
    reward: RewardSpec::Own {
        terms: &[
            HEIGHT_GAIN,
            TermSpec::new("limb_contact", 0.25, Kind::Rate(limb_contact)),
            TermSpec::new("success_bonus", 500.0, Kind::Condition(Cause::Success)),
            TermSpec::new("robot_fall", -200.0, Kind::Condition(Cause::Fall)),
        ],
        com_sway: -0.5,
    },
};

fn near_ladder(row: &Row, cx: &Context<'_>) -> bool {
    robot_distance(row, &row.body(errand::LADDER).pose.translation.vector) < cx.thresholds.ladder_near_m
}

fn climbs_slowly(row: &Row, cx: &Context<'_>) -> bool {
    row.robot.linear_velocity.norm() < cx.thresholds.climb_speed_m_s
}
