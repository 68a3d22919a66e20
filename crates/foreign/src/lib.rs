//! Foreign whole-body controllers, run from the user's own ONNX files. No weights are shipped.
//!
//! | controller | files | moves | commanded by |
//! |---|---|---|---|
//! | [`Gear`] | `Balance.onnx` and `Walk.onnx`, 516 numbers in, 15 out | legs and waist | velocity, height, torso |
//! | [`Sonic`] | `model_decoder.onnx`, 994 numbers in, 29 out | legs, waist and arms | a [`Token`] of 64 numbers |
//! | [`Encoder`] | `model_encoder.onnx`, 1762, 1751 or 1247 in, 64 out | gives tokens | poses of a tracked body |
//!
//! Sensor data and commands have the types of our own controller, [`fiatlux_wbc::Sensed`] and [`fiatlux_wbc::BodyCommand`].
//! A [`Plant`] says what a controller was made for (joints, control step and gains), and refuses a session that differs
//! with the name of the difference. Where two public sources of a controller disagree, a [`Reading`] selects one.
#![allow(missing_docs)] // Used in this repository alone.
mod encoder;
mod error;
mod files;
mod gear;
mod history;
mod model;
mod onnx;
mod plant;
mod sensed;
mod sonic;
mod token;

/// Number of body joints, in the public joint order, which is also the SDK's.
pub use fiatlux_wbc::BODY;

pub use encoder::{Encoder, Pose};
pub use error::ForeignError;
pub use files::{DECODER, GEAR_FILES, SHA256_LIST};
pub use gear::{Gear, HEIGHT, Reading};
pub use model::{Model, ModelFile};
pub use plant::{GainsRule, Plant};
pub use sonic::Sonic;
pub use token::{FixedToken, RecordedTokens, TOKEN, TOKEN_LIMIT, Token, TokenSource, token_of};
