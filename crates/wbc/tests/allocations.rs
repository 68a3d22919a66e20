//! Walking allocates nothing.
#![allow(clippy::unwrap_used)]

use std::sync::Arc;

use fiatlux_wbc::{ARMS, BodyCommand, Controller, MOVED, Network, Sensed, Swing};

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
    let walk = |(): &mut ()| {
        for _ in 0..100 {
            swing.step(&command, controller.stride(), [true, false], &mut targets);
            controller.step(&sensed, &command, &mut targets).unwrap();
        }
    };
    assert_eq!(fiatlux_allocations::count(|| (), walk), 0);
}
