//! Replace: the full errand, from a ladder that stands anywhere to the fresh bulb in the socket and the old one in the
//! crate.
//!
//! Start: as S01, the robot turned roughly towards the bench.
//!
//! It ends with either bulb's drop. Its published gate has no window: the bonus that a reward pays falls due on the first step,
//! while the hand still holds the fresh bulb. Strict, the errand is over where its last subtask is: both bulbs are let go and at rest,
//! and the robot is down again, as S12 asks for; the bonus falls due then. (That the ladder stands, S12 asks too: here a tip ends it.)

use super::bulb_criteria::{fresh_released, fresh_seated, fresh_settled, old_at_rest, old_released};
use super::page::*;
use crate::errand;

pub(crate) const SPEC: TaskSpec = TaskSpec {
    short_id: "replace",
    id: "Fiatlux-Replace-v1",
    name: "Replace Bulb",
    instruction: "change the lamp's bulb: put the old one into the yellow crate and insert the new one from the table",
    factors: &[],
    weight: 0.0,
    modes: &[ControlMode::FlatNavigation, ControlMode::Manipulation, ControlMode::Climbing],
    horizon_steps: 72_000,
    bulbs: &[Bulb::Old, Bulb::Fresh],
    start: StartSpec {
        ladder: Ladder::Free,
        robot: Stand::OwnZone,
        noise: ResetNoise::Usual,
        old_bulb: Spot::Socket,
        fresh_bulb: Spot::Bench,
        away_from_crate: false,
    },
    gate: Gate {
        criteria: &[
            Criterion { name: "fresh_bulb_seated", holds: fresh_seated },
            Criterion { name: "old_bulb_disposed", holds: old_disposed },
        ],
        sustain_steps: 1,
        strict: &[
            Criterion { name: "old_bulb_released", holds: old_released },
            Criterion { name: "old_bulb_at_rest", holds: old_at_rest },
            Criterion { name: "fresh_bulb_settled", holds: fresh_settled },
            Criterion { name: "fresh_bulb_released", holds: fresh_released },
            Criterion { name: "at_ladder_foot", holds: at_ladder_foot },
            STANDING,
            DOWN,
            UPRIGHT,
        ],
        strict_steps: ONE_SECOND,
        goals: 2,
    },
    start_count: 0,
    also_ends_on: Causes::of(&[Cause::Tip, Cause::Drop]),
    special: SpecialRules::NONE,
    reward: RewardSpec::Own {
        terms: &[
            // Progress: at most 5, 10, 5 and 10. All in all a perfect run earns at most 55.
            TermSpec::new("ladder_progress", 250.0, Kind::Approach(ladder_to_fixture)),
            TermSpec::new("fresh_bulb_progress", 500.0, Kind::Approach(fresh_bulb_to_seat)),
            TermSpec::new("old_bulb_removal", 250.0, Kind::Potential(old_bulb_clearance)),
            TermSpec::new("old_bulb_disposal_progress", 500.0, Kind::Approach(old_bulb_to_crate)),
            // Completion: 2, 5, 3, 5 and 10.
            TermSpec::new("ladder_ready", 100.0, Kind::Once(ladder_placed)),
            TermSpec::new("fresh_bulb_inserted", 250.0, Kind::Once(fresh_seated)),
            TermSpec::new("old_bulb_removed", 150.0, Kind::Once(|row, cx| removed(row, cx, Bulb::Old))),
            TermSpec::new("old_bulb_disposed", 250.0, Kind::Once(old_disposed)),
            TermSpec::new("success_bonus", 500.0, Kind::Condition(Cause::Success)),
            // Failures.
            TermSpec::new("robot_fall", -200.0, Kind::Condition(Cause::Fall)),
            TermSpec::new("ladder_tipped", -200.0, Kind::Condition(Cause::Tip)),
            TermSpec::new("fresh_bulb_dropped", -100.0, Kind::Once(|row, cx| dropped(row, cx, Bulb::Fresh))),
            TermSpec::new("old_bulb_dropped", -100.0, Kind::Once(|row, cx| dropped(row, cx, Bulb::Old))),
            TermSpec::new("contact_penalty", -1e-3, Kind::Rate(right_hand_force)),
        ],
        com_sway: -0.1,
    },
};

/// Out of the socket and in the crate.
fn old_disposed(row: &Row, cx: &Context<'_>) -> bool {
    !seated(row, Bulb::Old) && in_crate(row, cx, Bulb::Old)
}

/// From the old bulb to the crate, m; while it is seated, from where a seated bulb's root is.
fn old_bulb_to_crate(row: &Row, _cx: &Context<'_>) -> f64 {
    let root = if seated(row, Bulb::Old) { &row.body(errand::FIXTURE).pose } else { &row.body(errand::OLD_BULB).pose };
    (root.translation.vector - row.body(errand::CRATE).pose.translation.vector).norm()
}
