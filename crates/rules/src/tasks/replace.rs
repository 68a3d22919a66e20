//! Replace: the full errand, from a ladder that stands anywhere to the fresh bulb in the socket and the old one in the
//! crate.
//!
//! Start: as S01, the robot turned roughly towards the bench.
//!
//! It ends with either bulb's drop. Its gate has no window: the bonus that a reward pays falls due on the first step.

use super::bulb_criteria::fresh_seated;
use super::page::*;

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
    gate: Gate {
        criteria: &[
            Criterion { name: "fresh_bulb_seated", holds: fresh_seated },
            Criterion { name: "old_bulb_disposed", holds: old_disposed },
        ],
        sustain_steps: 1,
    },
    start_count: 0,
    also_ends_on: Causes::of(&[Cause::Tip, Cause::Drop]),
};

/// Out of the socket and in the crate.
pub(crate) fn old_disposed(row: &Row, cx: &Context<'_>) -> bool {
    !seated(row, Bulb::Old) && in_crate(row, cx, Bulb::Old)
}
