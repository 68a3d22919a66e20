//! Rows and targets from outside: absurd ones are refused or survived, never a panic.

use fiatlux_robot::GainSet;
use fiatlux_rules::{Row, errand};
use fiatlux_tests::{robot, scene};
use fiatlux_world::{SceneKind, World};
use nalgebra::Vector3;

/// The G1 with Inspire hands.
const JOINTS: usize = 53;

fn world() -> World {
    World::new(scene(SceneKind::FreeLadder, 0, robot().gains(GainSet::Fiatlux)))
}

#[test]
fn rows_that_no_world_can_start_from_are_refused() {
    let mut world = world();
    let good = world.row().clone();
    let mut refused = |edit: &dyn Fn(&mut Row), word: &str| {
        let mut row = good.clone();
        edit(&mut row);
        let message = world.reset_to(&row).expect_err(word).to_string();
        assert!(message.contains(word), "'{message}' does not say '{word}'");
        assert_eq!(world.row(), &good, "a refused row changes nothing");
    };
    refused(&|row| row.robot.pose.translation.z = f64::NAN, "robot");
    refused(&|row| row.robot.pose.rotation.as_mut_unchecked().w = 3.0, "length 1");
    refused(&|row| row.things[errand::FRESH_BULB].angular_velocity.x = f64::INFINITY, "fresh_bulb");
    refused(&|row| row.joint_velocity[7] = f64::NAN, "joint_velocity");
    refused(&|row| row.step = u64::MAX, "step");
    refused(&|row| row.attachments[0].steps_beyond = u32::MAX, "attachments");
    refused(&|row| row.attachments[1].seated = true, "seated");
}

#[test]
fn actions_and_targets_that_are_not_finite_are_refused() {
    let mut world = world();
    let (zero, mut bad) = ([0.0; JOINTS], [0.0; JOINTS]);
    bad[3] = f64::NAN;
    let before = world.row().clone();
    assert!(world.step(&zero, &bad).unwrap_err().to_string().contains("target of joint 'left_knee_joint'"));
    assert!(world.step(&bad, &zero).unwrap_err().to_string().contains("action of joint 'left_knee_joint'"));
    assert_eq!(world.row(), &before);
}

#[test]
fn absurd_but_finite_states_do_not_panic() {
    let mut world = world();
    let good = world.row().clone();
    for size in [1e3, 1e9, 1e150, 1e300] {
        let edits: [&dyn Fn(&mut Row); 5] = [
            &|row| row.robot.pose.translation.vector = Vector3::repeat(size),
            &|row| row.robot.linear_velocity = Vector3::new(0.0, size, -size),
            &|row| row.things[errand::OLD_BULB].angular_velocity = Vector3::new(size, 0.0, size),
            &|row| row.joint_velocity.fill(size),
            &|row| row.joint_position.fill(-size),
        ];
        for edit in edits {
            let mut row = good.clone();
            edit(&mut row);
            world.reset_to(&row).unwrap();
            for _ in 0..3 {
                world.step(&[0.0; JOINTS], &[size; JOINTS]).unwrap();
            }
        }
    }
    world.reset_to(&good).unwrap();
    world.step(&[0.0; JOINTS], &good.joint_target).unwrap();
    assert!(world.row().robot.pose.translation.z.is_finite(), "a good row starts a good world again");
}
