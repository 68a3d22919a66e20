//! Terms on how the robot moves, shared by all rewards.

use nalgebra::Vector3;

use super::term::{Kind, TermSpec, View};
use crate::errand;
use crate::parts::{Bulb, LIMBS, Limb};
use crate::row::{CONTROL_DT, Row};

/// Part of a joint's range, about its middle, that counts as soft (the G1 preset of Isaac Lab; the source names no
/// figure).
const SOFT_RANGE: f64 = 0.9;

/// The terms of every shaped reward; only the weight of the sway differs.
pub(crate) const fn terms(com_sway_weight: f64) -> [TermSpec; 7] {
    [
        TermSpec::new("com_sway", com_sway_weight, Kind::Rate(com_sway)),
        TermSpec::new("ang_vel_xy", -0.05, Kind::Rate(roll_and_pitch_rate)),
        TermSpec::new("action_rate", -0.005, Kind::Rate(action_rate)),
        TermSpec::new("joint_acceleration", -1.25e-7, Kind::Rate(joint_acceleration)),
        TermSpec::new("ankle_limits", -1.0, Kind::Rate(ankle_limits)),
        TermSpec::new("waist_deviation", -0.1, Kind::Rate(waist_deviation)),
        TermSpec::new("finger_deviation", -0.05, Kind::Rate(finger_deviation)),
    ]
}

/// Squared horizontal speed of the centre of mass, m^2/s^2.
fn com_sway(view: &View<'_>) -> f64 {
    view.row.com_velocity.xy().norm_squared()
}

/// Squared angular velocity of the pelvis about its x and y axes, rad^2/s^2.
fn roll_and_pitch_rate(view: &View<'_>) -> f64 {
    let pelvis = &view.row.robot;
    pelvis.pose.rotation.inverse_transform_vector(&pelvis.angular_velocity).xy().norm_squared()
}

/// Sum of squared changes of the action.
fn action_rate(view: &View<'_>) -> f64 {
    view.row.action.iter().zip(&view.before.action).map(|(after, before)| (after - before) * (after - before)).sum()
}

/// Sum of squared accelerations of hips and knees over the control step, rad^2/s^4.
fn joint_acceleration(view: &View<'_>) -> f64 {
    let (after, before) = (&view.row.joint_velocity, &view.before.joint_velocity);
    let acceleration = |joint: usize| (of_joint(after, joint) - of_joint(before, joint)) / CONTROL_DT;
    view.joints.legs.iter().map(|&joint| acceleration(joint) * acceleration(joint)).sum()
}

/// Distance of the ankles beyond their soft limits, rad.
fn ankle_limits(view: &View<'_>) -> f64 {
    let excess = |(joint, [lower, upper]): &(usize, [f64; 2])| {
        let (middle, soft_half) = ((lower + upper) / 2.0, SOFT_RANGE * (upper - lower) / 2.0);
        ((of_joint(&view.row.joint_position, *joint) - middle).abs() - soft_half).max(0.0)
    };
    view.joints.ankles.iter().map(excess).sum()
}

/// Sum of the waist joints' deviations from the standing posture, which has them at 0, rad.
fn waist_deviation(view: &View<'_>) -> f64 {
    deviation(view, &view.joints.waist)
}

/// Sum of the finger joints' deviations from the standing posture, which has them at 0, rad.
fn finger_deviation(view: &View<'_>) -> f64 {
    deviation(view, &view.joints.fingers)
}

fn deviation(view: &View<'_>, joints: &[usize]) -> f64 {
    joints.iter().map(|&joint| of_joint(&view.row.joint_position, joint).abs()).sum()
}

/// Sum of squared contact forces of both bulbs on the bodies of the right hand, N^2.
pub(crate) fn right_hand_force(view: &View<'_>) -> f64 {
    let [[old, _], [fresh, _]] = Bulb::ALL.map(|bulb| view.row.hands(bulb));
    old.iter().zip(fresh).map(|(a, b)| (a + b).norm_squared()).sum()
}

/// Sum of squared contact forces of one bulb on the bodies of both hands, N^2.
pub(crate) fn grip_force(row: &Row, bulb: Bulb) -> f64 {
    row.force(errand::HAND_FORCE[bulb as usize]).iter().map(Vector3::norm_squared).sum()
}

/// Part of some limbs that touch the ladder.
pub(crate) fn limbs_on_ladder(row: &Row, limbs: &[Limb], contact_n: f64) -> f64 {
    let loads = limbs.iter().map(|limb| row.force(errand::LADDER_FORCE)[*limb as usize].norm());
    loads.filter(|load| load.is_finite() && *load > contact_n).count() as f64 / limbs.len() as f64
}

/// Both feet and both palms.
pub(crate) const ALL_LIMBS: [Limb; LIMBS] = [Limb::LeftFoot, Limb::RightFoot, Limb::LeftPalm, Limb::RightPalm];

/// A joint's number; 0 for a joint that the robot lacks.
fn of_joint(numbers: &[f64], joint: usize) -> f64 {
    numbers.get(joint).copied().unwrap_or_default()
}
