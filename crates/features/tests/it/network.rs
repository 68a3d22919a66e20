//! Properties of the network with any weights: repeatable bytes, any fitting size, and errors for other sizes.

use data_encoding::HEXLOWER;
use fiatlux_features::{FEATURES, FeatureError, ResNet18, Weights};
use sha2::{Digest, Sha256};

fn pattern(width: usize, height: usize) -> Vec<u8> {
    (0..3 * width * height).map(|i| (i * 31 % 253) as u8).collect()
}

fn bits(features: &[f32; FEATURES]) -> Vec<u32> {
    features.iter().map(|feature| feature.to_bits()).collect()
}

/// Records name weights by seed, so the draw may never change.
#[test]
fn seeded_weights_are_pinned() {
    let digest = |seed| {
        let digest = Sha256::digest(Weights::seeded(seed).to_safetensors());
        HEXLOWER.encode(&digest)
    };
    assert_eq!(digest(0), "0b7785e8319f4b55716f0fb34dac3de27b35608072cfd3199bf2a5923e3d6486");
    assert_eq!(digest(1), "6d18271901b9a3ad834203e0c75a1c4ae826d0554596f034be2fda8f5eeeb1ae");
    assert_eq!(Weights::seeded(7).label(), "fiatlux-resnet18-seeded/1:7");
}

/// Guards that scratch memory and the images between the layers pass nothing on to the next image of any size.
#[test]
fn the_same_image_gives_the_same_bytes() {
    let weights = Weights::seeded(0);
    let mut network = ResNet18::new(&weights);
    let (square, wide) = (pattern(128, 128), pattern(160, 32));
    let first = bits(network.features(&square, 128, 128).unwrap());
    let first_wide = bits(network.features(&wide, 160, 32).unwrap());
    network.features(&vec![255; 3 * 256 * 256], 256, 256).unwrap();
    assert_eq!(bits(network.features(&square, 128, 128).unwrap()), first);
    network.features(&vec![255; 3 * 128 * 128], 128, 128).unwrap();
    assert_eq!(bits(network.features(&square, 128, 128).unwrap()), first);
    assert_eq!(bits(ResNet18::new(&weights).features(&wide, 160, 32).unwrap()), first_wide);
    assert_ne!(first, first_wide);
}

#[test]
fn images_that_do_not_fit_are_refused() {
    let mut network = ResNet18::new(&Weights::seeded(0));
    for (width, height) in [(0, 0), (256, 0), (33, 32), (256, 255), (1056, 32), (usize::MAX, usize::MAX)] {
        let refused = network.features(&[], width, height);
        assert!(matches!(refused, Err(FeatureError::ImageSize { .. })), "{width} x {height}");
    }
    for bytes in [0, 3 * 32 * 32 - 1, 4 * 32 * 32] {
        let error = network.features(&vec![0; bytes], 32, 32).unwrap_err().to_string();
        assert!(error.contains("expected 3072 bytes") && error.contains(&format!("found {bytes}")), "{error}");
    }
    network.features(&pattern(32, 32), 32, 32).unwrap();
}
