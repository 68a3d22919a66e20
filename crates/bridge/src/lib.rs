//! Model servers as policies: vision-language-action models that run elsewhere and speak their own protocols.
//!
//! A [`Model`] is asked for its [`Contract`] and for chunks of actions, in one of six [`Dialect`]s. A [`Mapping`] says what the
//! model's keys are on our robot: it makes a [`ModelObservation`] of what is sensed, and [`Row`]s of targets and commands of a
//! [`ModelChunk`]. [`check_contract`] and [`check_chunk`] name all that does not fit before anything moves. A [`Player`] says
//! which row a step has. Nothing here knows a simulator.
//!
//! What arrives is bounded in size and time, and every number is checked. No pickle is read or written.
mod check;
mod dialect;
mod error;
mod hands;
mod image;
mod mapping;
mod net;
mod observe;
mod pack;
mod play;
mod reach;
mod rows;
mod tensor;
mod websocket;
mod zmq;

pub use check::{Mismatch, MismatchKind, check_chunk, check_contract};
pub use dialect::{ActionTerms, CameraTerms, Contract, Dialect, Model, ModelChunk, ModelObservation, ModelOptions};
pub use error::BridgeError;
pub use hands::{Hands, Side};
pub use image::{Picture, Resize};
pub use mapping::{Body, Camera, Key, Mapping, Part, Representation, WAIST, default_mapping, shipped_names};
pub use net::{MAX_REPLY, Timeouts};
pub use observe::{Frames, Sensed};
pub use play::{Play, Played, Player};
pub use rows::Row;
pub use tensor::{Dtype, Tensor};
