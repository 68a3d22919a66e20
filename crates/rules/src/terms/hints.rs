//! Hints that several tasks give to a learner, and the measures that they share.

use super::motion;
use super::term::{Kind, TermSpec, View};
use crate::context::Context;
use crate::errand;
use crate::parts::{Bulb, Limb};
use crate::predicates::{robot_distance, seated};
use crate::row::Row;

/// Weight of a term that brings the robot or a thing nearer to its goal.
pub(crate) const TOWARDS: f64 = 500.0;
/// Weight of a potential on a grip, an axis or limbs on the ladder.
pub(crate) const HINT: f64 = 100.0;
/// Weight of squared forces on the hands.
const FORCE: f64 = -1e-4;

/// Pays for a pelvis that is higher than ever before.
pub(crate) const HEIGHT_GAIN: TermSpec = TermSpec::new("height_gain", TOWARDS, Kind::Record(pelvis_height));
/// Pays for a pelvis that is lower than ever before.
pub(crate) const DESCENT: TermSpec = TermSpec::new("descent", TOWARDS, Kind::Record(|row, cx| -pelvis_height(row, cx)));
/// Pays for limbs on the ladder.
pub(crate) const LIMBS: TermSpec = TermSpec::new("limb_contact", HINT, Kind::Potential(all_limbs));
/// Pays for limbs on the ladder, the right hand apart: it carries the bulb.
pub(crate) const FREE_LIMBS: TermSpec = TermSpec::new("limb_contact", HINT, Kind::Potential(limbs_beside_right_hand));
/// Charges forces of the old bulb on the hands.
pub(crate) const OLD_FORCE: TermSpec =
    TermSpec::new("hand_force", FORCE, Kind::Rate(|view| motion::grip_force(view.row, Bulb::Old)));
/// Charges forces of the fresh bulb on the hands.
pub(crate) const FRESH_FORCE: TermSpec =
    TermSpec::new("hand_force", FORCE, Kind::Rate(|view| motion::grip_force(view.row, Bulb::Fresh)));
/// Pays for the way to the ladder.
pub(crate) const ROBOT_TO_LADDER: TermSpec = TermSpec::new("robot_to_ladder", TOWARDS, Kind::Approach(robot_to_ladder));

/// Height of the pelvis, m.
pub(crate) fn pelvis_height(row: &Row, _cx: &Context<'_>) -> f64 {
    row.robot.pose.translation.vector.z
}

/// From the ladder's top point to the seat, m.
pub(crate) fn ladder_to_fixture(row: &Row, cx: &Context<'_>) -> f64 {
    (cx.geometry.ladder_top(row) - cx.geometry.seat(row)).norm()
}

/// From the fresh bulb's plug to the seat, m.
pub(crate) fn fresh_bulb_to_seat(row: &Row, cx: &Context<'_>) -> f64 {
    cx.geometry.plug_distance(row, Bulb::Fresh)
}

/// The old bulb's distance from the seat in parts of the clearance that counts as removed; none while it is seated.
pub(crate) fn old_bulb_clearance(row: &Row, cx: &Context<'_>) -> f64 {
    if seated(row, Bulb::Old) {
        return 0.0;
    }
    cx.geometry.plug_distance(row, Bulb::Old) / cx.thresholds.clear_of_seat_m
}

/// From the right palm to the bulb's root, m.
pub(crate) fn palm_to_bulb(row: &Row, bulb: Bulb) -> f64 {
    let right = row.world_from_palm[1].translation.vector;
    (right - row.body(bulb.thing()).pose.translation.vector).norm()
}

/// Part of all limbs that touch the ladder.
pub(crate) fn limb_contact(view: &View<'_>) -> f64 {
    all_limbs(view.row, view.context)
}

fn robot_to_ladder(row: &Row, _cx: &Context<'_>) -> f64 {
    robot_distance(row, &row.body(errand::LADDER).pose.translation.vector)
}

fn all_limbs(row: &Row, cx: &Context<'_>) -> f64 {
    motion::limbs_on_ladder(row, &motion::ALL_LIMBS, cx.thresholds.limb_contact_n)
}

fn limbs_beside_right_hand(row: &Row, cx: &Context<'_>) -> f64 {
    let limbs = [Limb::LeftFoot, Limb::RightFoot, Limb::LeftPalm];
    motion::limbs_on_ladder(row, &limbs, cx.thresholds.limb_contact_n)
}
