//! S01 Move Ladder: bring the ladder below the lamp and leave it standing there.
//!
//! Start: the ladder stands anywhere in the room, the robot in its own zone, turned towards the ladder. The old bulb is
//! in the socket, the fresh one on the bench.
//!
//! The first criterion reads the horizontal distance from the ladder's top point to the fixture: 0.67 m is what an
//! overhead reach of 1.37 m leaves for a fixture 1.17 m above the feet, less 5 cm.

use super::page::*;

pub(crate) const SPEC: TaskSpec = TaskSpec {
    short_id: "S01",
    id: "Fiatlux-S01-MoveLadder-v1",
    name: "Move Ladder",
    instruction: "walk to the ladder, bring it under the lamp fixture and set it up there",
    factors: &[Factor::Carry, Factor::Span],
    weight: 2.25,
    modes: &[ControlMode::FlatNavigation],
    horizon_steps: SUBTASK_HORIZON,
    bulbs: &[],
    start: StartSpec {
        ladder: Ladder::Free,
        robot: Stand::OwnZoneFacing(Landmark::Ladder),
        noise: ResetNoise::Usual,
        old_bulb: Spot::Socket,
        fresh_bulb: Spot::Bench,
        away_from_crate: false,
    },
    gate: Gate {
        criteria: &[
            Criterion { name: "ladder_placed", holds: ladder_placed },
            Criterion { name: "ladder_feet_down", holds: ladder_feet_down },
            Criterion { name: "ladder_at_rest", holds: ladder_at_rest },
            Criterion { name: "standing", holds: standing },
        ],
        sustain_steps: ONE_SECOND,
        strict: &[UPRIGHT],
        strict_steps: ONE_SECOND,
        goals: 1,
    },
    start_count: 3,
    also_ends_on: Causes::of(&[Cause::Tip]),
    special: SpecialRules::NONE,
    reward: RewardSpec::Subtask {
        hints: &[ROBOT_TO_LADDER, TermSpec::new("ladder_to_fixture", TOWARDS, Kind::Approach(ladder_to_fixture))],
    },
};
