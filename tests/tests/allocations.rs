//! A control step allocates nothing.
#![allow(clippy::unwrap_used, missing_docs)]

use std::alloc::System;

use fiatlux_robot::GainSet;
use fiatlux_rules::JOINTS;
use fiatlux_tests::{robot, scene};
use fiatlux_world::{SceneKind, World};
use stats_alloc::{INSTRUMENTED_SYSTEM, Region, StatsAlloc};

#[global_allocator]
static ALLOCATOR: &StatsAlloc<System> = &INSTRUMENTED_SYSTEM;

#[test]
fn a_fall_allocates_nothing() {
    let mut world = World::new(scene(SceneKind::FreeLadder, 0, robot().gains(GainSet::Fiatlux)));
    let target: [f64; JOINTS] = std::array::from_fn(|j| world.scene().robot.q0()[j]);
    let action = [0.0; JOINTS];
    let region = Region::new(ALLOCATOR);
    let mut contacts = 0;
    for _ in 0..500 {
        world.step(&action, &target).unwrap();
        contacts = contacts.max(world.dynamics().contacts().len());
    }
    let change = region.change();
    assert!(contacts > 20, "the fall must meet contact: {contacts}");
    assert_eq!((change.allocations, change.reallocations), (0, 0), "in 2000 physics steps");
}
