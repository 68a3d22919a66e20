//! Writes seeded weights as a safetensors file: `cargo run --release -p fiatlux-features --example write_weights --
//! FILE [SEED]`.

use fiatlux_features::Weights;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let path = arguments.next().ok_or("usage: write_weights FILE [SEED]")?;
    let seed = arguments.next().map_or(Ok(0), |seed| seed.parse())?;
    let weights = Weights::seeded(seed);
    std::fs::write(&path, weights.to_safetensors())?;
    println!("{} in {path}", weights.label());
    Ok(())
}
