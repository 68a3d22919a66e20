//! A foreign controller's step allocates nothing.
#![allow(clippy::unwrap_used)]

use std::path::Path;

use fiatlux_foreign::{BODY, Gear, Reading, Sonic, TOKEN};
use fiatlux_wbc::{BodyCommand, Sensed};

#[test]
fn a_step_allocates_nothing() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures");
    let zeros = [0.0; BODY];
    let sensed = Sensed::upright(&zeros, &zeros);
    let start = || {
        let gear = Gear::new(&Gear::read(&folder).unwrap(), Reading::Nvidia, &zeros).unwrap();
        (gear, Sonic::new(&Sonic::read(&folder).unwrap(), &zeros).unwrap(), [0.0; BODY])
    };
    let allocations = fiatlux_allocations::count(start, |(gear, sonic, targets)| {
        for velocity in [[0.0; 3], [0.4, 0.0, 0.2]] {
            gear.step(&sensed, &BodyCommand { velocity, ..BodyCommand::default() }, targets).unwrap();
            sonic.step(&sensed, &[0.1; TOKEN], targets).unwrap();
        }
    });
    assert_eq!(allocations, 0);
}
