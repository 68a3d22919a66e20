//! Milliseconds per frame of 256 x 256 pixels: `cargo run --release -p fiatlux-features --example time_features`.
#![expect(clippy::disallowed_methods, reason = "it measures time")]

use std::time::Instant;

use fiatlux_features::{ResNet18, Weights};

const SIDE: usize = 256;
const FRAMES: usize = 100;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let started = Instant::now();
    let mut network = ResNet18::new(&Weights::seeded(0));
    println!("made in {:.0} ms", started.elapsed().as_secs_f64() * 1e3);
    let image: Vec<u8> = (0..3 * SIDE * SIDE).map(|i| (i * 7 % 251) as u8).collect();
    network.features(&image, SIDE, SIDE)?;
    let mut times = Vec::new();
    for _ in 0..FRAMES {
        let started = Instant::now();
        network.features(&image, SIDE, SIDE)?;
        times.push(started.elapsed().as_secs_f64() * 1e3);
    }
    times.sort_by(f64::total_cmp);
    println!(
        "ms per frame: least {:.1}, median {:.1}, p99 {:.1}",
        times[0],
        times[FRAMES / 2],
        times[FRAMES * 99 / 100]
    );
    Ok(())
}
