//! Penalties on how the robot moves and on what its hands feel, one step of each.

use fiatlux_rules::{Limb, errand};
use nalgebra::Vector3;

use super::*;

#[test]
fn motion_penalties() {
    let before = start_of(Task::Climb);
    let mut row = before.clone();
    row.com_velocity = Vector3::new(0.3, -0.4, 9.0);
    // Turned by a quarter about x: the world's z is the pelvis's y.
    row.robot.pose = rotated([0.0, 0.0, 0.9], Vector3::x(), std::f64::consts::FRAC_PI_2);
    row.robot.angular_velocity = Vector3::new(2.0, 5.0, 1.0);
    row.action[7] = 2.0;
    row.joint_velocity[3] = 0.2;
    row.joint_velocity[4] = 9.0;
    row.joint_position[5] = -0.2618;
    row.joint_position[11] = 0.23;
    row.joint_position[13] = -0.3;
    row.joint_position[28] = 1.0;
    row.joint_position[29] = 0.5;
    row.joint_position[52] = -0.25;
    let meter = play(Task::Climb, Variant::Benchmark, &[&before, &row]);
    for (name, value) in [
        ("com_sway", -0.5 * 0.25),
        ("ang_vel_xy", -0.05 * 5.0),
        ("action_rate", -0.005 * 4.0),
        ("joint_acceleration", -1.25e-7 * 100.0),
        ("ankle_limits", -0.1 * 0.2618),
        ("waist_deviation", -0.1 * 0.3),
        ("finger_deviation", -0.05 * 0.75),
    ] {
        assert!(close(meter.paid(name), 0.02 * value), "{name}: {}", meter.paid(name));
    }
}

/// Soft limits are nine tenths of the G1's, about the middle of each range.
#[test]
fn ankle_limits() {
    // From -50 to 30 degrees.
    let [pitch_middle, pitch_half] = [-10.0_f64, 0.9 * 40.0].map(f64::to_radians);
    let before = start_of(Task::Climb);
    for (joint, angle, excess) in [
        (4, pitch_middle + pitch_half - 0.001, 0.0),
        (4, pitch_middle + pitch_half + 0.02, 0.02),
        (10, pitch_middle - pitch_half - 0.03, 0.03),
        (5, 0.9 * 0.2618 + 0.02, 0.02),
        (11, -0.9 * 0.2618 - 0.01, 0.01),
        (11, -0.9 * 0.2618 + 0.001, 0.0),
        (3, 2.0, 0.0),
    ] {
        let mut row = before.clone();
        row.joint_position[joint] = angle;
        let paid = play(Task::Climb, Variant::Benchmark, &[&before, &row]).paid("ankle_limits");
        assert!((paid + 0.02 * excess).abs() < 1e-6, "joint {joint} at {angle}: {paid}");
    }
}

/// The right hand's bodies feel both bulbs; the left hand's do not count in the errand.
#[test]
fn force_penalties() {
    let start = start_of(Task::Replace);
    let mut row = start.clone();
    row.force_mut(errand::HAND_FORCE[OLD])[3] = Vector3::new(3.0, 0.0, 0.0);
    row.force_mut(errand::HAND_FORCE[NEW])[3] = Vector3::new(-1.0, 4.0, 0.0);
    row.force_mut(errand::HAND_FORCE[NEW])[16] = Vector3::new(0.0, 0.0, 2.0);
    row.force_mut(errand::HAND_FORCE[NEW])[17] = Vector3::new(0.0, 7.0, 0.0);
    let meter = play(Task::Replace, Variant::Benchmark, &[&start, &row]);
    assert!(close(meter.paid("contact_penalty"), -1e-3 * 0.02 * 24.0));
}

/// Each limb loaded by more than 1 N is a quarter, in every step anew.
#[test]
fn limbs_on_the_ladder_pay_each_step() {
    let mut row = start_of(Task::Climb);
    for (limb, load, limbs) in [
        (Limb::LeftFoot, 1.001, 1.0),
        (Limb::RightPalm, 0.999, 1.0),
        (Limb::RightFoot, 300.0, 2.0),
        (Limb::LeftPalm, 2.0, 3.0),
        (Limb::RightPalm, 1.001, 4.0),
    ] {
        row.force_mut(errand::LADDER_FORCE)[limb as usize] = Vector3::new(0.6 * load, 0.0, -0.8 * load);
        let meter = play(Task::Climb, Variant::Benchmark, &[&row, &row, &row]);
        assert!(close(meter.paid("limb_contact"), 2.0 * 0.02 * 0.25 * limbs / 4.0), "{limb:?} {load}");
    }
}
