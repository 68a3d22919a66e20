//! Shaping for training on the subtasks: terms that all share, and each task's own.

use super::climb::pelvis_height;
use super::motion;
use super::replace::{fresh_bulb_to_seat, ladder_to_fixture, old_bulb_clearance};
use super::term::{Kind, TermSpec};
use crate::predicates::robot_distance;
use crate::{Bulb, Cause, Causes, Context, Limb, Row, Task, measure};

/// Weight of a term that brings the robot or a thing nearer to its goal.
const TOWARDS: f64 = 500.0;
/// Weight of a potential on a grip, an axis or limbs on the ladder.
const HINT: f64 = 100.0;
/// Weight of squared forces on the hands.
const FORCE: f64 = -1e-4;
/// Weight of a failure.
const FAILURE: f64 = -200.0;

pub(super) fn terms(task: Task, ends_on: Causes) -> Vec<TermSpec> {
    let mut terms = vec![TermSpec::GATE_PROGRESS];
    terms.push(TermSpec::new("success_bonus", 500.0, Kind::Condition(Cause::Success)));
    let failures = Cause::ALL.into_iter().filter_map(|cause| Some((cause, failure_name(cause)?)));
    let failures = failures.filter(|(cause, _)| ends_on.contains(*cause));
    terms.extend(failures.map(|(cause, name)| TermSpec::new(name, FAILURE, Kind::Condition(cause))));
    terms.extend(own_terms(task).iter().map(|(name, weight, kind)| TermSpec::new(name, *weight, *kind)));
    terms.extend([
        TermSpec::new("com_sway", -0.5, Kind::Rate(motion::com_sway)),
        TermSpec::new("ang_vel_xy", -0.05, Kind::Rate(motion::roll_and_pitch_rate)),
        TermSpec::new("action_rate", -0.005, Kind::Rate(motion::action_rate)),
        TermSpec::new("joint_acceleration", -1.25e-7, Kind::Rate(motion::joint_acceleration)),
        TermSpec::new("ankle_limits", -1.0, Kind::Rate(motion::ankle_limits)),
        TermSpec::new("waist_deviation", -0.1, Kind::Rate(motion::waist_deviation)),
        TermSpec::new("finger_deviation", -0.05, Kind::Rate(motion::finger_deviation)),
    ]);
    terms
}

/// Name of the term that charges a failure; `None` for what is none.
fn failure_name(cause: Cause) -> Option<&'static str> {
    match cause {
        Cause::Fall => Some("robot_fall"),
        Cause::Tip => Some("ladder_tipped"),
        Cause::Crush => Some("bulb_crushed"),
        Cause::Drop => Some("bulb_dropped"),
        Cause::Unseated => Some("bulb_unseated"),
        Cause::Impact => Some("bulb_impact"),
        Cause::Success | Cause::TimeOut => None,
    }
}

fn own_terms(task: Task) -> &'static [(&'static str, f64, Kind)] {
    const LIMBS: (&str, f64, Kind) = ("limb_contact", HINT, Kind::Potential(limbs));
    const FREE_LIMBS: (&str, f64, Kind) = ("limb_contact", HINT, Kind::Potential(limbs_beside_right_hand));
    const UP: (&str, f64, Kind) = ("height_gain", TOWARDS, Kind::Record(pelvis_height));
    const DOWN: (&str, f64, Kind) = ("descent", TOWARDS, Kind::Record(pelvis_depth));
    const OLD_FORCE: (&str, f64, Kind) = ("hand_force", FORCE, Kind::Rate(|v| motion::grip_force(v.row, Bulb::Old)));
    const FRESH_FORCE: (&str, f64, Kind) =
        ("hand_force", FORCE, Kind::Rate(|v| motion::grip_force(v.row, Bulb::Fresh)));
    match task {
        Task::S01 => &[
            ("robot_to_ladder", TOWARDS, Kind::Approach(robot_to_ladder)),
            ("ladder_to_fixture", TOWARDS, Kind::Approach(ladder_to_fixture)),
        ],
        Task::S02 => &[UP, LIMBS],
        Task::S03 => &[
            ("hand_to_bulb", TOWARDS, Kind::Approach(|row, _| palm_to_bulb(row, Bulb::Old))),
            ("old_bulb_removal", TOWARDS, Kind::Potential(old_bulb_clearance)),
            OLD_FORCE,
        ],
        Task::S04 => &[DOWN, FREE_LIMBS, OLD_FORCE],
        Task::S05 => &[("robot_to_crate", TOWARDS, Kind::Approach(robot_to_crate))],
        Task::S06 => &[("bulb_to_crate", TOWARDS, Kind::Approach(bulb_to_crate))],
        Task::S07 => &[("robot_to_bulb", TOWARDS, Kind::Approach(robot_to_fresh_bulb))],
        Task::S08 => &[
            ("hand_to_bulb", TOWARDS, Kind::Approach(|row, _| palm_to_bulb(row, Bulb::Fresh))),
            ("grip", HINT, Kind::Potential(fresh_bulb_grip)),
            FRESH_FORCE,
        ],
        Task::S09 => &[("robot_to_ladder", TOWARDS, Kind::Approach(robot_to_ladder))],
        Task::S10 => &[UP, FREE_LIMBS, FRESH_FORCE],
        Task::S11 => &[
            ("fresh_bulb_to_seat", TOWARDS, Kind::Approach(fresh_bulb_to_seat)),
            ("axis_alignment", HINT, Kind::Potential(axis_alignment)),
            FRESH_FORCE,
        ],
        Task::S12 => &[DOWN, LIMBS],
        Task::Replace | Task::Climb => &[],
    }
}

fn robot_to_ladder(row: &Row, _cx: &Context<'_>) -> f64 {
    robot_distance(row, &row.ladder.pose.translation.vector)
}

fn robot_to_crate(row: &Row, _cx: &Context<'_>) -> f64 {
    robot_distance(row, &row.crate_.translation.vector)
}

fn robot_to_fresh_bulb(row: &Row, _cx: &Context<'_>) -> f64 {
    robot_distance(row, &row.bulbs[Bulb::Fresh as usize].pose.translation.vector)
}

fn bulb_to_crate(row: &Row, _cx: &Context<'_>) -> f64 {
    (row.bulbs[Bulb::Old as usize].pose.translation.vector - row.crate_.translation.vector).norm()
}

/// From the right palm to the bulb's root.
fn palm_to_bulb(row: &Row, bulb: Bulb) -> f64 {
    let [_, right] = row.palm_position;
    (right - row.bulbs[bulb as usize].pose.translation.vector).norm()
}

fn pelvis_depth(row: &Row, cx: &Context<'_>) -> f64 {
    -pelvis_height(row, cx)
}

/// Grows with the largest contact force on a hand body, over tens of newtons.
fn fresh_bulb_grip(row: &Row, _cx: &Context<'_>) -> f64 {
    let forces = row.hand_force[Bulb::Fresh as usize].iter().map(nalgebra::Vector3::norm);
    libm::tanh(forces.filter(|force| force.is_finite()).fold(0.0, f64::max) / 10.0)
}

/// 1 where the bulb's axis is that of the socket, falling off over tenths of a radian.
fn axis_alignment(row: &Row, _cx: &Context<'_>) -> f64 {
    let [bulb, socket] =
        [row.bulbs[Bulb::Fresh as usize].pose, row.fixture].map(|pose| pose.rotation * nalgebra::Vector3::z());
    1.0 - libm::tanh(measure::angle_between(&bulb, &socket) / 0.3)
}

fn limbs(row: &Row, cx: &Context<'_>) -> f64 {
    motion::limbs_on_ladder(row, &motion::ALL_LIMBS, cx.thresholds.limb_contact_n)
}

/// The right hand carries the bulb.
fn limbs_beside_right_hand(row: &Row, cx: &Context<'_>) -> f64 {
    let limbs = [Limb::LeftFoot, Limb::RightFoot, Limb::LeftPalm];
    motion::limbs_on_ladder(row, &limbs, cx.thresholds.limb_contact_n)
}
