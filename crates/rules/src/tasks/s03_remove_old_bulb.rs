//! S03 Remove Old Bulb: pull the spent bulb out of the socket and keep it in the hand.
//!
//! Start: the robot stands on the platform, facing the fixture, hands free. The old bulb is in the socket, the fresh
//! one on the bench.

use super::bulb_criteria::{old_elevated, old_held};
use super::page::*;

pub(crate) const SPEC: TaskSpec = TaskSpec {
    short_id: "S03",
    id: "Fiatlux-S03-RemoveOldBulb-v1",
    name: "Remove Old Bulb",
    instruction: "take hold of the bulb in the lamp fixture and pull it out",
    factors: &[Factor::Grasp, Factor::Balance, Factor::Mate],
    weight: 4.2,
    modes: &[ControlMode::Manipulation, ControlMode::Climbing],
    horizon_steps: SUBTASK_HORIZON,
    bulbs: &[Bulb::Old],
    start: StartSpec {
        ladder: Ladder::Coupled,
        robot: Stand::Platform,
        noise: ResetNoise::AtLadder,
        old_bulb: Spot::Socket,
        fresh_bulb: Spot::Bench,
        away_from_crate: false,
    },
    gate: Gate {
        criteria: &[
            Criterion { name: "old_bulb_removed", holds: old_removed },
            Criterion { name: "old_bulb_held", holds: old_held },
            Criterion { name: "old_bulb_elevated", holds: old_elevated },
            Criterion { name: "standing", holds: standing },
            Criterion { name: "ladder_upright", holds: ladder_upright },
        ],
        sustain_steps: HALF_SECOND,
        strict: &[UP, OLD_GRIP, UPRIGHT],
        strict_steps: ONE_SECOND,
        goals: 1,
    },
    start_count: 3,
    also_ends_on: Causes::of(&[Cause::Tip, Cause::Crush, Cause::Drop]),
    special: SpecialRules::NONE,
    reward: RewardSpec::Subtask {
        hints: &[
            TermSpec::new("hand_to_bulb", TOWARDS, Kind::Approach(|row, _| palm_to_bulb(row, Bulb::Old))),
            TermSpec::new("old_bulb_removal", TOWARDS, Kind::Potential(old_bulb_clearance)),
            OLD_FORCE,
        ],
    },
};

fn old_removed(row: &Row, cx: &Context<'_>) -> bool {
    removed(row, cx, Bulb::Old)
}
