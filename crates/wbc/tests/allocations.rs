//! Walking allocates nothing.
#![allow(clippy::unwrap_used)]

use std::alloc::System;
use std::sync::Arc;

use fiatlux_wbc::{ARMS, BodyCommand, Controller, MOVED, Network, Sensed, Swing};
use stats_alloc::{INSTRUMENTED_SYSTEM, Region, StatsAlloc};

#[global_allocator]
static ALLOCATOR: &StatsAlloc<System> = &INSTRUMENTED_SYSTEM;

#[test]
fn walking_allocates_nothing() {
    let mut controller = Controller::new(Arc::new(Network::shipped().unwrap()));
    let zeros = [0.0; MOVED + ARMS];
    let sensed = Sensed::upright(&zeros, &zeros);
    let command = BodyCommand { velocity: [0.4, 0.0, 0.2], ..BodyCommand::default() };
    let mut targets = [0.0; MOVED + ARMS];
    let mut swing = Swing::new(&targets);
    // The first step is one of standing, which looks where the links are.
    controller.step(&sensed, &command, &mut targets).unwrap();
    let region = Region::new(ALLOCATOR);
    for _ in 0..100 {
        swing.step(&command, controller.stride(), [true, false], &mut targets);
        controller.step(&sensed, &command, &mut targets).unwrap();
    }
    assert_eq!(region.change().allocations, 0);
}
