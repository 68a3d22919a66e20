//! The features against PyTorch's (`tests/oracle/features.py` at the root of the repository).

use std::collections::BTreeMap;

use data_encoding::HEXLOWER;
use fiatlux_features::{FEATURES, ResNet18, Weights};
use serde::Deserialize;
use serde_json::Value;
use sha2::{Digest, Sha256};

const SIDE: usize = 256;
const FIXTURE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/oracle/fixtures/features.json");

/// Maximum difference from PyTorch, relative to the largest feature of the image, and to each feature that is above
/// [`SMALL`] of the largest.
const BAR: f64 = 1e-4;
const SMALL: f64 = 1e-3;

#[derive(Deserialize)]
struct Fixture {
    weights_sha256: String,
    cases: BTreeMap<String, BTreeMap<String, Vec<f64>>>,
}

/// By the same formulas as the script's.
fn images() -> BTreeMap<&'static str, Vec<u8>> {
    let pixels = || (0..SIDE * SIDE).map(|i| (i % SIDE, i / SIDE));
    let ramp = pixels().flat_map(|(x, y)| [x, y, (x + y) / 2]).map(|value| value as u8).collect();
    let mut state = 1_u32;
    let mut noise = vec![0; 3 * SIDE * SIDE];
    for byte in &mut noise {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        *byte = (state >> 24) as u8;
    }
    let box_at = |x: usize, y: usize, c: usize| 200 * ((x / 32 + y / 32 + c) % 2) + (x * y + 17 * c) % 56;
    let boxes = pixels().flat_map(|(x, y)| [0, 1, 2].map(|c| box_at(x, y, c) as u8)).collect();
    BTreeMap::from([("ramp", ramp), ("noise", noise), ("boxes", boxes)])
}

/// The file with batch norms by the script's formula, which those of seeded weights would not show.
fn with_norms(mut file: Vec<u8>) -> Vec<u8> {
    let length = u64::from_le_bytes(file[..8].try_into().unwrap()) as usize;
    let header: BTreeMap<String, Value> = serde_json::from_slice(&file[8..8 + length]).unwrap();
    let mut changed = 0;
    for norm in header.keys().filter_map(|name| name.strip_suffix(".running_var")) {
        for tensor in ["weight", "bias", "running_mean", "running_var"] {
            let offsets = &header[&format!("{norm}.{tensor}")]["data_offsets"];
            let at = |i: usize| 8 + length + offsets[i].as_u64().unwrap() as usize;
            for (i, bytes) in file[at(0)..at(1)].as_chunks_mut::<4>().0.iter_mut().enumerate() {
                let i = i as f32;
                let value = match tensor {
                    "weight" => 0.5 + i % 7.0 / 8.0,
                    "bias" => (i % 5.0 - 2.0) / 4.0,
                    "running_mean" => (i % 3.0 - 1.0) / 2.0,
                    _ => 0.25 + i % 11.0 / 4.0,
                };
                *bytes = value.to_le_bytes();
            }
            changed += 1;
        }
    }
    assert_eq!(changed, 80);
    file
}

#[test]
fn features_are_those_of_pytorch() {
    let fixture: Fixture = serde_json::from_slice(&std::fs::read(FIXTURE).unwrap()).unwrap();
    let file = Weights::seeded(0).to_safetensors();
    let digest: String = HEXLOWER.encode(&Sha256::digest(&file));
    assert_eq!(digest, fixture.weights_sha256, "the fixture is of other weights");
    let mut compared = 0;
    for (case, expected) in &fixture.cases {
        let bytes = if case == "norms" { with_norms(file.clone()) } else { file.clone() };
        let mut network = ResNet18::new(&Weights::from_safetensors_bytes(&bytes).unwrap());
        for (image, rgb) in images() {
            let found = network.features(&rgb, SIDE, SIDE).unwrap();
            let expected = &expected[image];
            assert_eq!(expected.len(), FEATURES);
            let largest = expected.iter().copied().fold(0.0, f64::max);
            let (mut of_largest, mut of_own) = (0.0_f64, 0.0_f64);
            for (&found, &expected) in found.iter().zip(expected) {
                let off = (f64::from(found) - expected).abs();
                of_largest = of_largest.max(off / largest);
                if expected > SMALL * largest {
                    of_own = of_own.max(off / expected);
                }
            }
            println!("{case}, {image}: {of_largest:.1e} of the largest feature, {of_own:.1e} of its own");
            assert!(of_largest < BAR && of_own < BAR, "{case}, {image}: {of_largest:.1e}, {of_own:.1e}");
            compared += 1;
        }
    }
    assert_eq!(compared, 6);
}
