//! Time of a control step: `cargo run --release -p fiatlux-wbc --example time_wbc`.
#![allow(clippy::disallowed_methods)] // It times.

use std::sync::Arc;
use std::time::Instant;

use fiatlux_wbc::{ARMS, BodyCommand, Controller, MOVED, Network, Sensed, WbcError};

fn main() -> Result<(), WbcError> {
    let mut controller = Controller::new(Arc::new(Network::shipped()?));
    let zeros = [0.0; MOVED + ARMS];
    let sensed = Sensed::upright(&zeros, &zeros);
    let mut targets = [0.0; MOVED];
    let mut times: Vec<f64> = Vec::new();
    for _ in 0..2000 {
        let start = Instant::now();
        controller.step(&sensed, &BodyCommand::default(), &mut targets)?;
        times.push(start.elapsed().as_secs_f64() * 1e6);
    }
    times.sort_by(f64::total_cmp);
    println!("{:.1} us in the median, {:.1} us in 99 of 100", times[1000], times[1980]);
    Ok(())
}
