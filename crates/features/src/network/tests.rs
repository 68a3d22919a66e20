#![allow(clippy::unwrap_used)]

use super::*;

/// Largest difference from the features in f32, by the norm of all, that whole numbers may make.
const BAR: f64 = 0.02;

fn image(side: usize) -> Vec<u8> {
    (0..3 * side * side).map(|i| ((i / 3 % side / 8 + i / 3 / side / 8) % 2 * 120 + i * 7 % 101) as u8).collect()
}

fn norm(numbers: impl Iterator<Item = f64>) -> f64 {
    numbers.map(|x| x * x).sum::<f64>().sqrt()
}

#[test]
fn int8_is_near_f32_and_the_same_on_every_level() {
    let weights = Weights::seeded(0);
    let mut single = ResNet18::new(&weights);
    let mut whole = ResNet18::with(&weights, Arithmetic::Int8);
    assert_eq!(whole.label(), format!("{}{INT8}", single.label()));
    let side = 96;
    let rgb = image(side);
    let expected = *single.features(&rgb, side, side).unwrap();
    let found = *whole.features(&rgb, side, side).unwrap();
    let off = norm(found.iter().zip(&expected).map(|(a, b)| f64::from(a - b)));
    let error = off / norm(expected.iter().map(|x| f64::from(*x)));
    assert!(error < BAR && error > 0.0, "{side}: error of {error}");
    let levels = [Level::baseline()].into_iter();
    #[cfg(target_arch = "x86_64")]
    let levels = levels.chain(Level::new().as_avx2().map(Level::Avx2));
    for level in levels {
        let mut other = whole.twin();
        other.level = level;
        assert_eq!(*other.features(&rgb, side, side).unwrap(), found, "{side}: {level:?}");
    }
}

#[test]
fn names_say_the_arithmetic() {
    for (name, own, arithmetic) in [
        ("", "", Arithmetic::Single),
        ("int8", "", Arithmetic::Int8),
        ("a.safetensors", "a.safetensors", Arithmetic::Single),
        ("a.safetensors+int8", "a.safetensors", Arithmetic::Int8),
    ] {
        assert_eq!(Arithmetic::of_name(name), (own, arithmetic));
    }
}
