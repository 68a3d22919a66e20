//! Rewards of walking, per second.

use fiatlux_rules::{CONTROL_DT, Row, Support, errand};
use fiatlux_wbc::{LEGS, MOVED};
use fiatlux_world::World;
use nalgebra::{UnitQuaternion, Vector3};

use super::Walking;

/// Inputs of a term.
pub(super) struct View<'a> {
    pub walking: &'a Walking,
    pub world: &'a World,
    pub row: &'a Row,
    /// Result of [`velocity`] for the row.
    pub velocity: Vector3<f64>,
    pub fell: bool,
}

/// Name, weight a second, value.
pub(super) type TermOf = (&'static str, f64, fn(&View<'_>) -> f64);

pub(super) const TERMS: [TermOf; 30] = [
    ("track_lin_vel", 1.0, |view| libm::exp(-velocity_error(view, &view.velocity) / 0.25)),
    ("track_lin_vel_smoothed", 1.5, |view| libm::exp(-velocity_error(view, &view.walking.slow_velocity) / 0.06)),
    ("lin_vel_error", -2.0, |view| velocity_error(view, &view.walking.slow_velocity).sqrt()),
    ("track_ang_vel", 1.5, track_ang_vel),
    ("ang_vel_error", -1.0, ang_vel_error),
    ("alive", 0.5, |_| 1.0),
    ("feet_height", 1.5, feet_height),
    ("feet_contact", 1.0, feet_contact),
    ("termination", -100.0, |view| f64::from(u8::from(view.fell))),
    ("track_base_height", 1.5, |view| libm::exp(-square(height_error(view)) / 0.0025)),
    ("base_height_error", -40.0, |view| square(height_error(view))),
    ("joint_deviation_knee", -2.0, joint_deviation_knee),
    ("track_torso_orientation", 1.2, |view| libm::exp(-torso_error(view) / 0.05)),
    ("torso_orientation_error", -1.5, |view| torso_error(view).sqrt()),
    ("flat_orientation", -40.0, flat_orientation),
    ("lin_vel_z", -0.5, |view| square(view.row.robot.linear_velocity.z)),
    ("ang_vel_xy", -0.05, ang_vel_xy),
    ("joint_torques", -1.5e-5, |view| squares(&view.row.joint_effort[..MOVED])),
    ("joint_vel", -5e-4, |view| squares(&view.row.joint_velocity[..MOVED])),
    ("joint_acc", -1.5e-7, joint_acc),
    ("action_rate", -0.03, action_rate),
    ("action_smoothness", -0.01, action_smoothness),
    ("joint_deviation", -1.0, joint_deviation),
    ("joint_pos_limits", -5.0, joint_pos_limits),
    ("feet_slide", -0.25, feet_slide),
    ("feet_distance", -5.0, feet_distance),
    ("feet_orientation", -8.0, feet_orientation),
    ("feet_impact", -0.1, feet_impact),
    ("stand_still", -0.3, stand_still),
    ("stand_still_motion", -1.0, stand_still_motion),
];

/// Part of a joint's range, about its middle, that is free.
const FREE_RANGE: f64 = 0.95;
/// Least and greatest distance between the feet, m.
const APART: [f64; 2] = [0.21, 0.40];
/// From this load on a foot stands, N.
const LOADED: f64 = 20.0;
const SUPPORTS: [Support; 2] = [Support::LeftFoot, Support::RightFoot];

/// The pelvis's turn about the vertical.
pub(super) fn heading(row: &Row) -> UnitQuaternion<f64> {
    let ahead = row.robot.pose.rotation * Vector3::x();
    UnitQuaternion::from_axis_angle(&Vector3::z_axis(), libm::atan2(ahead.y, ahead.x))
}

/// Forwards, left and about the vertical, as commanded: m/s, m/s, rad/s.
pub(super) fn velocity(row: &Row) -> Vector3<f64> {
    let local = heading(row).inverse_transform_vector(&row.robot.linear_velocity);
    Vector3::new(local.x, local.y, row.robot.angular_velocity.z)
}

fn square(number: f64) -> f64 {
    number * number
}

fn squares(numbers: &[f64]) -> f64 {
    numbers.iter().map(|number| number * number).sum()
}

/// Squared, over both axes. A policy feels the instantaneous velocity at once; the slow one is not blurred by its steps.
fn velocity_error(view: &View<'_>, velocity: &Vector3<f64>) -> f64 {
    let [x, y, _] = view.walking.setpoint.now().velocity;
    square(velocity.x - x) + square(velocity.y - y)
}

fn track_ang_vel(view: &View<'_>) -> f64 {
    let [.., turn] = view.walking.setpoint.now().velocity;
    0.4 * libm::exp(-square(view.velocity.z - turn)) + 0.6 * libm::exp(-square(ang_vel_error(view)) / 0.2)
}

/// Of the slow velocity. Unlike the kernels it pulls as hard when little is missing.
fn ang_vel_error(view: &View<'_>) -> f64 {
    let [.., turn] = view.walking.setpoint.now().velocity;
    (view.walking.slow_velocity.z - turn).abs()
}

fn feet_height(view: &View<'_>) -> f64 {
    let Walking { clock, foot_position, .. } = view.walking;
    let error: f64 = (0..2).map(|foot| square(foot_position[foot].z - clock.height(foot))).sum();
    libm::exp(-error / 0.004)
}

fn is_loaded(view: &View<'_>, foot: usize) -> bool {
    view.row.load(errand::FLOOR_LOAD)[SUPPORTS[foot] as usize] > LOADED
}

fn feet_contact(view: &View<'_>) -> f64 {
    (0..2).filter(|&foot| is_loaded(view, foot) == view.walking.clock.is_down(foot)).count() as f64
}

fn ang_vel_xy(view: &View<'_>) -> f64 {
    let pelvis = &view.row.robot;
    pelvis.pose.rotation.inverse_transform_vector(&pelvis.angular_velocity).xy().norm_squared()
}

/// Roll, pitch and yaw of the torso, from upright axes that point where the pelvis points, rad.
pub(super) fn torso(world: &World, link: usize) -> [f64; 3] {
    let (roll, pitch, yaw) = (heading(world.row()).inverse() * world.world_from_link(link).rotation).euler_angles();
    [roll, pitch, yaw]
}

fn height_error(view: &View<'_>) -> f64 {
    view.row.robot.pose.translation.z - view.walking.setpoint.now().height
}

/// Sum of the knees' angles by which they are straighter than the height asks for, rad.
fn joint_deviation_knee(view: &View<'_>) -> f64 {
    let knees = &view.walking.knees;
    let least = knees.least(view.walking.setpoint.now().height);
    knees.joints.iter().map(|joint| (least - view.row.joint_position[*joint]).max(0.0)).sum()
}

/// Squared, over all three angles.
fn torso_error(view: &View<'_>) -> f64 {
    let angles = torso(view.world, view.walking.torso);
    angles.iter().zip(view.walking.setpoint.now().torso).map(|(angle, wanted)| square(angle - wanted)).sum()
}

/// Squared, off the share that the pelvis has in the torso's lean. Low down its pitch is free: the ankles' stop would end
/// the way down otherwise.
fn flat_orientation(view: &View<'_>) -> f64 {
    let (roll, pitch, _) = (heading(view.row).inverse() * view.row.robot.pose.rotation).euler_angles();
    let command = view.walking.setpoint.now();
    let held = ((command.height - 0.55) / 0.1).clamp(0.1, 1.0);
    square(roll - 0.2 * command.torso[0]) + held * square(pitch - 0.25 * command.torso[1])
}

fn joint_acc(view: &View<'_>) -> f64 {
    let speeds = view.row.joint_velocity.iter().zip(&view.walking.joint_velocity).take(MOVED);
    speeds.map(|(after, before)| square((after - before) / CONTROL_DT)).sum()
}

fn action_rate(view: &View<'_>) -> f64 {
    let [new, old, _] = &view.walking.actions;
    new.iter().zip(old).map(|(new, old)| square(new - old)).sum()
}

fn action_smoothness(view: &View<'_>) -> f64 {
    let [new, old, older] = &view.walking.actions;
    (0..MOVED).map(|joint| square(new[joint] - 2.0 * old[joint] + older[joint])).sum()
}

/// Hips turned sideways or inwards and, by half, rolled ankles: off q0.
fn joint_deviation(view: &View<'_>) -> f64 {
    let q0 = view.world.scene().robot.q0();
    let off = |joint: usize| square(view.row.joint_position[joint] - q0[joint]);
    let leg = |first: usize| off(first + 1) + off(first + 2) + 0.5 * off(first + 5);
    leg(0) + leg(LEGS / 2)
}

/// Sum of the joints' angles beyond the free part of their ranges, rad.
fn joint_pos_limits(view: &View<'_>) -> f64 {
    let joints = view.world.scene().robot.joints().iter().zip(&view.row.joint_position).take(MOVED);
    let beyond = joints.map(|(joint, q)| {
        let (middle, half) = (0.5 * (joint.lower + joint.upper), 0.5 * (joint.upper - joint.lower));
        ((q - middle).abs() - FREE_RANGE * half).max(0.0)
    });
    beyond.sum()
}

/// Squared speed of feet that stand.
fn feet_slide(view: &View<'_>) -> f64 {
    let standing = (0..2).filter(|&foot| is_loaded(view, foot));
    standing.map(|foot| view.walking.foot_velocity[foot].xy().norm_squared()).sum()
}

/// Distance by which the feet are nearer or wider apart than comfortable, m.
fn feet_distance(view: &View<'_>) -> f64 {
    let [left, right] = &view.walking.foot_position;
    let apart = heading(view.row).inverse_transform_vector(&(left - right)).y;
    (APART[0] - apart).max(apart - APART[1]).max(0.0)
}

/// Squared sines of the tilts of soles that bear a load. With a small weight the robot stands on the edges of its feet.
fn feet_orientation(view: &View<'_>) -> f64 {
    let lean = |link: usize| view.world.world_from_link(link).rotation.inverse_transform_vector(&Vector3::z());
    let standing = (0..2).filter(|&foot| is_loaded(view, foot));
    standing.map(|foot| lean(view.walking.feet[foot]).xy().norm_squared()).sum()
}

/// Load of each foot above 500 N, by 100 N.
fn feet_impact(view: &View<'_>) -> f64 {
    SUPPORTS
        .iter()
        .map(|foot| ((view.row.load(errand::FLOOR_LOAD)[*foot as usize] - 500.0) / 100.0).clamp(0.0, 20.0))
        .sum()
}

/// On a command to stand: legs that differ, rad, and one foot before the other, m.
fn stand_still(view: &View<'_>) -> f64 {
    if !view.walking.clock.stands() {
        return 0.0;
    }
    let q = &view.row.joint_position;
    let differ: f64 = [0, 3, 4].iter().map(|joint| (q[*joint] - q[LEGS / 2 + joint]).abs()).sum();
    let [left, right] = &view.walking.foot_position;
    let abreast = heading(view.row).inverse_transform_vector(&(left - right)).x;
    differ + 2.0 * abreast.abs()
}

/// On a command to stand: speed of the joints and of the feet, squared.
fn stand_still_motion(view: &View<'_>) -> f64 {
    if !view.walking.clock.stands() {
        return 0.0;
    }
    let feet: f64 = view.walking.foot_velocity.iter().map(Vector3::norm_squared).sum();
    2e-3 * squares(&view.row.joint_velocity[..MOVED]) + feet.min(10.0)
}
