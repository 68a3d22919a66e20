//! The reward of the full errand. A perfect run earns at most 55.

use super::motion;
use super::term::{Kind, TermSpec};
use crate::predicates::{dropped, ladder_placed, removed, seated};
use crate::tasks::replace::old_disposed;
use crate::{Bulb, Cause, Context, Row};

pub(super) fn terms() -> Vec<TermSpec> {
    let term = TermSpec::new;
    vec![
        // Progress: at most 5, 10, 5 and 10.
        term("ladder_progress", 250.0, Kind::Approach(ladder_to_fixture)),
        term("fresh_bulb_progress", 500.0, Kind::Approach(fresh_bulb_to_seat)),
        term("old_bulb_removal", 250.0, Kind::Potential(old_bulb_clearance)),
        term("old_bulb_disposal_progress", 500.0, Kind::Approach(old_bulb_to_crate)),
        // Completion: 2, 5, 3, 5 and 10.
        term("ladder_ready", 100.0, Kind::Once(ladder_placed)),
        term("fresh_bulb_inserted", 250.0, Kind::Once(|row, _| seated(row, Bulb::Fresh))),
        term("old_bulb_removed", 150.0, Kind::Once(|row, cx| removed(row, cx, Bulb::Old))),
        term("old_bulb_disposed", 250.0, Kind::Once(old_disposed)),
        term("success_bonus", 500.0, Kind::Condition(Cause::Success)),
        // Failures.
        term("robot_fall", -200.0, Kind::Condition(Cause::Fall)),
        term("ladder_tipped", -200.0, Kind::Condition(Cause::Tip)),
        term("fresh_bulb_dropped", -100.0, Kind::Once(|row, cx| dropped(row, cx, Bulb::Fresh))),
        term("old_bulb_dropped", -100.0, Kind::Once(|row, cx| dropped(row, cx, Bulb::Old))),
        // Motion.
        term("contact_penalty", -1e-3, Kind::Rate(motion::right_hand_force)),
        term("com_sway", -0.1, Kind::Rate(motion::com_sway)),
        term("ang_vel_xy", -0.05, Kind::Rate(motion::roll_and_pitch_rate)),
        term("action_rate", -0.005, Kind::Rate(motion::action_rate)),
        term("joint_acceleration", -1.25e-7, Kind::Rate(motion::joint_acceleration)),
        term("ankle_limits", -1.0, Kind::Rate(motion::ankle_limits)),
        term("waist_deviation", -0.1, Kind::Rate(motion::waist_deviation)),
        term("finger_deviation", -0.05, Kind::Rate(motion::finger_deviation)),
    ]
}

/// From the ladder's top point to the seat, m.
pub(super) fn ladder_to_fixture(row: &Row, cx: &Context<'_>) -> f64 {
    (cx.geometry.ladder_top(row) - cx.geometry.seat(row)).norm()
}

/// From the fresh bulb's plug to the seat, m.
pub(super) fn fresh_bulb_to_seat(row: &Row, cx: &Context<'_>) -> f64 {
    cx.geometry.plug_distance(row, Bulb::Fresh)
}

/// The old bulb's distance from the seat in parts of the clearance that counts as removed; none while it is seated.
pub(super) fn old_bulb_clearance(row: &Row, cx: &Context<'_>) -> f64 {
    if seated(row, Bulb::Old) {
        return 0.0;
    }
    cx.geometry.plug_distance(row, Bulb::Old) / cx.thresholds.clear_of_seat_m
}

/// From the old bulb to the crate, m; while it is seated, from where a seated bulb's root is.
fn old_bulb_to_crate(row: &Row, _cx: &Context<'_>) -> f64 {
    let root = if seated(row, Bulb::Old) { &row.fixture } else { &row.bulbs[Bulb::Old as usize].pose };
    (root.translation.vector - row.crate_.translation.vector).norm()
}
