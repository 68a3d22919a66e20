//! Activation functions from one exponential, which is a polynomial: the same on every machine and free of branches, so
//! that a loop over a layer becomes vector instructions.

/// e to the power of `x`, which counts as -80 or 80 beyond them. The relative error is below 2e-7.
#[inline(always)]
pub fn exp(x: f32) -> f32 {
    const LOG2_E: f32 = std::f32::consts::LOG2_E;
    /// ln 2 in two parts, the first exact in the product below.
    const LN_2: [f32; 2] = [0.693_359_4, -2.121_944_4e-4];
    let x = x.clamp(-80.0, 80.0);
    // Halves are rounded up, which is as good here as to even.
    let shifted = x * LOG2_E + 127.5;
    let power = shifted as i32;
    let whole = (power - 127) as f32;
    let rest = (x - whole * LN_2[0]) - whole * LN_2[1];
    // Taylor's series, exact to 1e-7 within half of ln 2.
    let series = 1.0 / 720.0 + rest / 5040.0;
    let series = 1.0 / 24.0 + rest * (1.0 / 120.0 + rest * series);
    let series = 1.0 + rest * (1.0 + rest * (0.5 + rest * (1.0 / 6.0 + rest * series)));
    series * f32::from_bits((power as u32) << 23)
}

/// The exponential linear unit.
#[inline(always)]
pub fn elu(x: f32) -> f32 {
    if x > 0.0 { x } else { exp(x.clamp(-80.0, 0.0)) - 1.0 }
}

/// The logistic function, 1 / (1 + exp(-x)).
#[inline(always)]
pub fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + exp(-x))
}

#[cfg(test)]
mod tests {
    use super::{elu, exp, sigmoid};

    #[test]
    fn functions_are_the_closed_forms() {
        for step in -8000..8000 {
            let x = step as f32 * 0.01;
            let power = libm::exp(f64::from(x));
            assert!((f64::from(exp(x)) / power - 1.0).abs() < 2e-7, "exp({x}) = {} instead of {power}", exp(x));
        }
        for step in -4000..200 {
            let x = step as f32 * 0.005;
            let expected = if x > 0.0 { f64::from(x) } else { libm::expm1(f64::from(x)) };
            assert!((f64::from(elu(x)) - expected).abs() < 2e-7, "elu({x}) = {} instead of {expected}", elu(x));
            let expected = 1.0 / (1.0 + libm::exp(-f64::from(x)));
            assert!((f64::from(sigmoid(x)) - expected).abs() < 2e-7, "sigmoid({x}) = {}", sigmoid(x));
        }
        assert_eq!((elu(-1e9), sigmoid(1e9), elu(f32::MAX)), (-1.0, 1.0, f32::MAX));
        assert!(sigmoid(-1e9) < 1e-30);
        assert!(elu(f32::NAN).is_nan() && sigmoid(f32::NAN).is_nan());
    }
}
