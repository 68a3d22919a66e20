//! S02 Climb Ladder: get up the ladder with free hands.
//!
//! Start: the robot stands on the floor 0.85 m from the ladder on the side of its steps and faces it. The ladder is
//! below the fixture. The old bulb is in the socket, the fresh one on the bench.
//!
//! The gate reads the pelvis against the ladder's top point, so the second tread is high enough for it; whether the
//! robot reached working height is recorded next to it.

use super::page::*;

pub(crate) const SPEC: TaskSpec = TaskSpec {
    short_id: "S02",
    id: "Fiatlux-S02-ClimbLadder-v1",
    name: "Climb Ladder",
    instruction: "climb the ladder up to its top steps",
    factors: &[Factor::Balance, Factor::Traverse],
    weight: 3.0,
    modes: &[ControlMode::Climbing],
    horizon_steps: SUBTASK_HORIZON,
    bulbs: &[],
    start: StartSpec {
        ladder: Ladder::Coupled,
        robot: Stand::LadderSteps,
        noise: ResetNoise::AtLadder,
        old_bulb: Spot::Socket,
        fresh_bulb: Spot::Bench,
        away_from_crate: false,
    },
    gate: Gate {
        criteria: &[
            Criterion { name: "at_ladder_top", holds: at_ladder_top },
            Criterion { name: "standing", holds: standing },
            Criterion { name: "ladder_upright", holds: ladder_upright },
        ],
        sustain_steps: 1,
        strict: &[UP, UPRIGHT],
        strict_steps: ONE_SECOND,
        goals: 1,
    },
    start_count: 2,
    also_ends_on: Causes::of(&[Cause::Tip]),
    special: SpecialRules { notes_working_height: true, ..SpecialRules::NONE },
    reward: RewardSpec::Subtask { hints: &[HEIGHT_GAIN, LIMBS] },
};
