//! S12 Climb Down: get down the ladder with free hands.
//!
//! Start: the robot stands on the platform, facing the fixture, hands free. The fresh bulb is in the socket, the old
//! one in the crate.
//!
//! The first criterion is that of S04. The second reads the socket's hold, so a seated bulb may twist.

use super::bulb_criteria::fresh_seated;
use super::page::*;

pub(crate) const SPEC: TaskSpec = TaskSpec {
    short_id: "S12",
    id: "Fiatlux-S12-ClimbDown-v1",
    name: "Climb Down",
    instruction: "climb down the ladder",
    factors: &[Factor::Balance, Factor::Traverse],
    weight: 3.0,
    modes: &[ControlMode::Climbing],
    horizon_steps: SUBTASK_HORIZON,
    bulbs: &[],
    start: StartSpec {
        ladder: Ladder::Coupled,
        robot: Stand::Platform,
        noise: ResetNoise::AtLadder,
        old_bulb: Spot::Crate,
        fresh_bulb: Spot::Socket,
        away_from_crate: false,
    },
    gate: Gate {
        criteria: &[
            Criterion { name: "at_ladder_foot", holds: at_ladder_foot },
            Criterion { name: "fresh_bulb_seated", holds: fresh_seated },
            Criterion { name: "standing", holds: standing },
            Criterion { name: "ladder_upright", holds: ladder_upright },
        ],
        sustain_steps: 1,
        strict: &[DOWN, UPRIGHT],
        strict_steps: ONE_SECOND,
        goals: 1,
    },
    start_count: 3,
    also_ends_on: Causes::of(&[Cause::Tip, Cause::Unseated]),
    special: SpecialRules { keeps_seated: Some(Bulb::Fresh), ..SpecialRules::NONE },
    reward: RewardSpec::Subtask { hints: &[DESCENT, LIMBS] },
};
