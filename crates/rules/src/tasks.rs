//! The tasks, one page for each: its description, start, gate, ends, special rules and reward.
//!
//! Every task also ends on success, on a fall of the robot and at its horizon. Starts are data, which the world carries
//! out; figures of places and noise stand in its scene config. The hints are what training pays in addition. `strict` lists
//! what that protocol asks for besides; `strict.rs` has these criteria and their reasons.

pub(crate) mod climb;
pub(crate) mod replace;
pub(crate) mod s01_move_ladder;
pub(crate) mod s02_climb_ladder;
pub(crate) mod s03_remove_old_bulb;
pub(crate) mod s04_descend_with_bulb;
pub(crate) mod s05_carry_to_disposal;
pub(crate) mod s06_dispose_bulb;
pub(crate) mod s07_approach_new_bulb;
pub(crate) mod s08_grab_new_bulb;
pub(crate) mod s09_carry_to_ladder;
pub(crate) mod s10_climb_with_bulb;
pub(crate) mod s11_screw_in_bulb;
pub(crate) mod s12_climb_down;

/// Names that every task file uses.
mod page {
    pub(super) use fiatlux_judge::{Cause, Causes};

    pub(super) use crate::context::{Context, Criterion, Gate};
    pub(super) use crate::errand;
    pub(super) use crate::measure;
    pub(super) use crate::parts::Bulb;
    pub(super) use crate::predicates::*;
    pub(super) use crate::row::Row;
    pub(super) use crate::spec::*;
    pub(super) use crate::strict::{DOWN, FRESH_GRIP, OLD_GRIP, SLOW, STANDING, UP, UPRIGHT};
    pub(super) use crate::terms::hints::*;
    pub(super) use crate::terms::motion::right_hand_force;
    pub(super) use crate::terms::term::{Kind, TermSpec};
}

/// Criteria on one of the bulbs that several gates share.
mod bulb_criteria {
    use super::page::*;

    pub(super) fn old_held(row: &Row, cx: &Context<'_>) -> bool {
        held(row, cx, Bulb::Old)
    }

    pub(super) fn old_released(row: &Row, cx: &Context<'_>) -> bool {
        released(row, cx, Bulb::Old)
    }

    pub(super) fn old_at_rest(row: &Row, cx: &Context<'_>) -> bool {
        row.body(errand::OLD_BULB).linear_velocity.norm() < cx.thresholds.rest_speed_m_s
    }

    pub(super) fn old_elevated(row: &Row, cx: &Context<'_>) -> bool {
        elevated(row, cx, Bulb::Old)
    }

    pub(super) fn fresh_held(row: &Row, cx: &Context<'_>) -> bool {
        held(row, cx, Bulb::Fresh)
    }

    pub(super) fn fresh_released(row: &Row, cx: &Context<'_>) -> bool {
        released(row, cx, Bulb::Fresh)
    }

    pub(super) fn fresh_elevated(row: &Row, cx: &Context<'_>) -> bool {
        elevated(row, cx, Bulb::Fresh)
    }

    pub(super) fn fresh_settled(_row: &Row, cx: &Context<'_>) -> bool {
        settled(cx, Bulb::Fresh)
    }

    pub(super) fn fresh_seated(row: &Row, _cx: &Context<'_>) -> bool {
        seated(row, Bulb::Fresh)
    }
}
