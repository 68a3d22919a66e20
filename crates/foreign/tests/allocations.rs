//! A foreign controller's step allocates nothing.
#![allow(clippy::unwrap_used)]

use std::alloc::System;
use std::path::Path;

use fiatlux_foreign::{BODY, Gear, Reading, Sonic, TOKEN};
use fiatlux_wbc::{BodyCommand, Sensed};
use stats_alloc::{INSTRUMENTED_SYSTEM, Region, StatsAlloc};

#[global_allocator]
static ALLOCATOR: &StatsAlloc<System> = &INSTRUMENTED_SYSTEM;

#[test]
fn a_step_allocates_nothing() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures");
    let zeros = [0.0; BODY];
    let sensed = Sensed::upright(&zeros, &zeros);
    let mut gear = Gear::new(&Gear::read(&folder).unwrap(), Reading::Nvidia, &zeros).unwrap();
    let mut sonic = Sonic::new(&Sonic::read(&folder).unwrap(), &zeros).unwrap();
    let mut targets = [0.0; BODY];
    let region = Region::new(ALLOCATOR);
    for velocity in [[0.0; 3], [0.4, 0.0, 0.2]] {
        gear.step(&sensed, &BodyCommand { velocity, ..BodyCommand::default() }, &mut targets).unwrap();
        sonic.step(&sensed, &[0.1; TOKEN], &mut targets).unwrap();
    }
    assert_eq!(region.change().allocations, 0);
}
