//! Arithmetic of neural networks on one thread of the CPU: the matrix product and the activation functions that our
//! controller, the image features and the user's ONNX files share.
//!
//! A number is always summed in the order of its inputs, so the same build on the same machine gives the same bytes.
//! [`Rounding`] says whether the same bytes come from every machine.
#![allow(missing_docs)] // Used in this repository alone.
mod activations;
mod dense;
mod product;

pub use activations::{elu, exp, sigmoid};
pub use dense::{Dense, Rounding};
pub use product::{Finish, Gathered, LANES, Panels, Target, multiply};
