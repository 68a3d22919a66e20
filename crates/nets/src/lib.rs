//! Arithmetic of neural networks on one thread of the CPU: the matrix product, the convolution and the activation
//! functions that our controller, the image features, policies that see and the user's ONNX files share.
//!
//! A number is always summed in the order of its inputs, so the same build on the same machine gives the same bytes.
//! [`Rounding`] says whether the same bytes come from every machine.
#![allow(missing_docs)] // Used in this repository alone.
mod activations;
mod convolution;
mod dense;
mod plane;
mod product;
mod whole;

pub use activations::{elu, exp, sigmoid};
pub use convolution::{Convolution, MAX_KERNEL};
pub use dense::{Dense, Rounding};
pub use plane::Plane;
pub use product::{Finish, Gathered, LANES, Panels, Target, multiply};
pub use whole::{PAIR, Steps, WholeConvolution, WholePanels, multiply_whole};

/// Largest difference of a network's results from those of its training: relative, but absolute below 1.
pub fn largest_difference(found: &[f32], expected: &[f32]) -> f32 {
    let differ = |(found, expected): (&f32, &f32)| (found - expected).abs() / expected.abs().max(1.0);
    found.iter().zip(expected).map(differ).fold(0.0, f32::max)
}
