//! Time of a control step, with random networks of realistic size or with those in a folder: `cargo run
//! --release -p fiatlux-foreign --example time_foreign [FOLDER]`.
#![allow(clippy::disallowed_methods)] // It measures time.

#[path = "../tests/it/networks.rs"]
mod networks;

use std::path::{Path, PathBuf};
use std::time::Instant;

use fiatlux_foreign::{BODY, DECODER, ForeignError, GEAR_FILES, Gear, Model, ModelFile, Reading, Sonic, TOKEN};
use fiatlux_wbc::{BodyCommand, Sensed};

const STEPS: usize = 1000;

fn main() -> Result<(), ForeignError> {
    let folder = std::env::args_os().nth(1).map(PathBuf::from);
    let zeros = [0.0; BODY];
    let sensed = Sensed::upright(&zeros, &zeros);
    let command = BodyCommand { velocity: [0.4, 0.0, 0.2], ..BodyCommand::default() };
    let mut targets = [0.0; BODY];

    let walk: &[usize] = &[516, 512, 256, 128, 15];
    let models = match &folder {
        Some(folder) => Gear::read(folder)?,
        None => [random(&GEAR_FILES[0], walk)?, random(&GEAR_FILES[1], walk)?],
    };
    let mut gear = Gear::new(&models, Reading::Nvidia, &zeros)?;
    time("gear", || gear.step(&sensed, &command, &mut targets))?;
    let models = match &folder {
        Some(folder) => vec![Sonic::read(folder)?],
        None => vec![
            random(&DECODER, &[994, 512, 512, 256, 29])?,
            random(&DECODER, &[994, 1024, 1024, 512, 512, 29])?,
            random(&DECODER, &[994, 2048, 2048, 1024, 1024, 512, 29])?,
        ],
    };
    for model in models {
        let mut sonic = Sonic::new(&model, &zeros)?;
        time("sonic", || sonic.step(&sensed, &[0.0; TOKEN], &mut targets))?;
    }
    Ok(())
}

fn random(file: &ModelFile, sizes: &[usize]) -> Result<Model, ForeignError> {
    let weights: usize = sizes.windows(2).map(|pair| pair[0] * pair[1]).sum();
    println!("random network {sizes:?}: {:.1} MB of weights", 4e-6 * weights as f64);
    Model::from_bytes(&networks::bytes(&networks::perceptron(sizes, 1)), Path::new("random"), file)
}

fn time(name: &str, mut step: impl FnMut() -> Result<(), ForeignError>) -> Result<(), ForeignError> {
    let mut times: Vec<f64> = Vec::with_capacity(STEPS);
    step()?;
    for _ in 0..STEPS {
        let start = Instant::now();
        step()?;
        times.push(start.elapsed().as_secs_f64() * 1e6);
    }
    times.sort_by(f64::total_cmp);
    let (least, median, slow) = (times[0], times[STEPS / 2], times[STEPS * 99 / 100]);
    println!("{name}: {median:.1} us in the median, {slow:.1} us in 99 of 100, {least:.1} us at least");
    Ok(())
}
