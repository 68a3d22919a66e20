//! Features of the head camera: the 512 numbers that ResNet-18 makes of an image before its classifier, inferred on one
//! thread of the CPU.
//!
//! ```text
//! safetensors file or seed -> Weights -> ResNet18::new -> features(rgb) -> 512 numbers
//! ```
//!
//! Batch norm is folded into the convolutions. Those of 3 x 3 at stride 1, five sixths of the work, go by Winograd's
//! method; the others are one matrix product over the window, gathered in place. All products run on one inner loop
//! over weights packed once.
//!
//! The order of every sum is fixed, so the same build on the same machine gives the same bytes. The loop takes the
//! widest vector instructions that the CPU has, with or without fused multiplication, so two kinds of CPU differ in the
//! last digits: features are an observation and stand outside the digest of an episode. [`Arithmetic::Int8`] computes in whole
//! numbers, faster and with the same bytes on every CPU.
//!
//! ```
//! use fiatlux_features::{FEATURES, FeatureError, ResNet18, Weights};
//!
//! // Untrained weights, drawn from a documented seed; a safetensors file of torchvision's network goes the same way.
//! let mut network = ResNet18::new(&Weights::seeded(0));
//! let grey = vec![128; 3 * 64 * 64];
//! let features = network.features(&grey, 64, 64)?.to_vec();
//! assert_eq!(features.len(), FEATURES);
//! assert!(features.iter().all(|feature| feature.is_finite()));
//! assert_eq!(network.features(&grey, 64, 64)?, &features[..]);
//! # Ok::<(), FeatureError>(())
//! ```
#![allow(missing_docs)] // Used in this repository alone.
mod error;
mod folded;
mod layers;
mod network;
mod tiles;
mod weights;
mod winograd;

pub use error::FeatureError;
pub use network::{Arithmetic, FEATURES, INT8, MEAN, ResNet18, SIDE_LIMIT, SIDE_STEP, STD};
pub use weights::{SEEDED_NAME, Weights};
