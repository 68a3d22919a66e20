//! Milliseconds per frame of 256 x 256 pixels, in f32 and in whole numbers, in turns; and how far apart the features are:
//! `cargo run --release -p fiatlux-features --example time_features`.
#![expect(clippy::disallowed_methods, reason = "it measures time")]

use std::time::Instant;

use fiatlux_features::{Arithmetic, ResNet18, Weights};

const SIDE: usize = 256;
const FRAMES: usize = 100;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let started = Instant::now();
    let weights = Weights::seeded(0);
    let mut networks = [Arithmetic::Single, Arithmetic::Int8].map(|form| ResNet18::with(&weights, form));
    println!("both made in {:.0} ms", started.elapsed().as_secs_f64() * 1e3);
    let image: Vec<u8> = (0..3 * SIDE * SIDE).map(|i| (i * 7 % 251) as u8).collect();
    let mut features = Vec::new();
    for network in &mut networks {
        features.push(*network.features(&image, SIDE, SIDE)?);
    }
    let norm =
        |numbers: &mut dyn Iterator<Item = f32>| numbers.map(|x| f64::from(x) * f64::from(x)).sum::<f64>().sqrt();
    let off = norm(&mut features[0].iter().zip(&features[1]).map(|(a, b)| a - b));
    println!("int8 is off by {:.2} % of the norm", 100.0 * off / norm(&mut features[0].iter().copied()));
    let mut times = [Vec::new(), Vec::new()];
    for _ in 0..FRAMES {
        for (network, times) in networks.iter_mut().zip(&mut times) {
            let started = Instant::now();
            network.features(&image, SIDE, SIDE)?;
            times.push(started.elapsed().as_secs_f64() * 1e3);
        }
    }
    for (name, times) in ["f32", "int8"].into_iter().zip(&mut times) {
        times.sort_by(f64::total_cmp);
        let [least, median, late] = [0, FRAMES / 2, FRAMES * 99 / 100].map(|rank| times[rank]);
        println!("{name}, ms per frame: least {least:.1}, median {median:.1}, p99 {late:.1}");
    }
    Ok(())
}
