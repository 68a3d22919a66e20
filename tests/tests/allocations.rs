//! A control step allocates nothing.
#![allow(clippy::unwrap_used, missing_docs)]

use std::f64::consts::FRAC_PI_2;

use fiatlux_dynamics::Contact;
use fiatlux_robot::GainSet;
use fiatlux_rules::{Bulb, Task, errand};
use fiatlux_tests::{robot, scene};
use fiatlux_world::{SceneKind, ShapeOwner, StartOptions, World, start};
use nalgebra::{Isometry3, Vector3};

/// Control steps of a case: enough to fall and come to rest.
const STEPS: usize = 500;

/// Contacts of a case while it was measured, so that none is measured in the air.
#[derive(Debug, Default)]
struct Measured {
    /// Most contacts of a physics step.
    contacts: usize,
    /// Control steps in which the robot pressed on the ladder, and in which a hand pressed the fresh bulb.
    on_ladder: usize,
    bulb_held: usize,
}

fn steps(world: impl Fn() -> World, name: &str) -> Measured {
    let start = || {
        let world = world();
        let (target, action) = (world.row().joint_target.clone(), world.row().action.clone());
        (world, target, action)
    };
    let mut measured = Measured::default();
    let allocations = fiatlux_allocations::count(start, |(world, target, action)| {
        measured = Measured::default();
        for _ in 0..STEPS {
            world.step(action, target).unwrap();
            let contacts = world.dynamics().contacts();
            measured.contacts = measured.contacts.max(contacts.len());
            measured.on_ladder += usize::from(contacts.iter().any(|contact| is_on_ladder(world, contact)));
            let forces = world.row().force(errand::HAND_FORCE[Bulb::Fresh as usize]);
            measured.bulb_held += usize::from(forces.iter().any(|force| force.norm() > 1.0));
        }
    });
    println!("{name}: {allocations} allocations, {measured:?}");
    assert_eq!(allocations, 0, "{name}");
    measured
}

fn is_on_ladder(world: &World, contact: &Contact) -> bool {
    let owners = [contact.shape_a, contact.shape_b].map(|shape| world.scene().owner(shape));
    let robot = owners.iter().any(|owner| matches!(owner, ShapeOwner::Robot(_)));
    robot && owners.contains(&ShapeOwner::LADDER) && contact.force.norm() > 0.0
}

/// A world whose targets are its joint angles.
fn world() -> World {
    let mut world = World::new(scene(SceneKind::FreeLadder, 0, robot().gains(GainSet::Fiatlux)));
    let mut row = world.row().clone();
    row.joint_target = world.scene().robot.q0().to_vec();
    row.action.fill(0.0);
    world.reset_to(&row).unwrap();
    world
}

/// The robot before the ladder's steps, pushed towards it.
fn pushed_to_ladder() -> World {
    let mut world = world();
    let mut row = world.row().clone();
    let ladder_from_pelvis = Isometry3::new(Vector3::new(0.0, -0.85, 0.0), Vector3::z() * FRAC_PI_2);
    row.robot.pose = world.scene().world_from(errand::LADDER) * ladder_from_pelvis;
    row.robot.pose.translation.z = world.scene().robot.standing_height();
    row.robot.linear_velocity = row.robot.pose.rotation * Vector3::new(0.8, 0.0, 0.0);
    world.reset_to(&row).unwrap();
    world
}

fn with_bulb_in_hand() -> World {
    let scene = scene(SceneKind::of(Task::S10), 0, robot().gains(GainSet::Fiatlux));
    start(scene, Task::S10, 0, &StartOptions::default()).unwrap()
}

#[test]
fn steps_in_contact_allocate_nothing() {
    let fall = steps(world, "a fall");
    assert!(fall.contacts > 20, "the fall must meet contact: {fall:?}");
    let ladder = steps(pushed_to_ladder, "a fall onto the ladder");
    assert!(ladder.on_ladder > STEPS / 10, "the robot must lean on the ladder: {ladder:?}");
    let bulb = steps(with_bulb_in_hand, "a bulb in the hand");
    assert!(bulb.bulb_held > STEPS / 10, "the hand must hold the bulb: {bulb:?}");
}
