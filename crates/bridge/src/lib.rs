//! Model servers as policies: vision-language-action models that run elsewhere and speak their own protocols.
//!
//! A [`Model`] gives its [`Contract`] and chunks of actions, in one of six [`Dialect`]s. A [`Mapping`] says which parts
//! of our robot the model's keys stand for: it turns sensor data into a [`ModelObservation`], and a [`ModelChunk`] into
//! [`Row`]s of targets and commands. [`check_contract`] and [`check_chunk`] name all differences before anything moves.
//! A [`Player`] says which row applies to a step. This crate knows no simulator.
//!
//! Whatever arrives is limited in size and time, and every number is checked. Pickles are neither read nor written.
#![allow(missing_docs)] // Used in this repository alone.
mod check;
mod dialect;
mod error;
mod hands;
mod image;
mod lidar;
mod mapping;
mod mismatch;
mod net;
mod observe;
mod pack;
mod play;
mod pose;
mod reach;
mod representation;
mod rows;
mod tensor;
mod websocket;
mod zmq;

pub use check::{check_chunk, check_contract};
pub use dialect::{ActionTerms, CameraTerms, Contract, Dialect, Model, ModelChunk, ModelObservation, ModelOptions};
pub use error::BridgeError;
pub use hands::{Hands, Side};
pub use image::{Picture, Resize};
pub use mapping::{Body, Camera, Key, KeyPart, Mapping, WAIST, default_mapping, shipped_names};
pub use mismatch::{Mismatch, MismatchKind};
pub use net::{MAX_REPLY, Timeouts};
pub use observe::{Frames, Sensed};
pub use play::{Play, PlayedRow, Player};
pub use pose::{BodyFrame, BodyMotion, BodyStream};
pub use representation::Representation;
pub use rows::Row;
pub use tensor::{Dtype, Form, Tensor};
