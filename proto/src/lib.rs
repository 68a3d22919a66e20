//! The service's language: messages, key expressions, limits and the version of the protocol.
//!
//! Messages are protobuf (`proto/proto/fiatlux/v3/*.proto`, where every field is described); [`v3`] has them as Rust
//! types. [`foxglove`] has the well-known messages by which a viewer shows a bag. Nothing here does I/O.
//!
//! ```
//! use fiatlux_proto::keys::ServerKeys;
//! use fiatlux_proto::limits::MAX_CLIENT_MESSAGE;
//! use fiatlux_proto::v3::Action;
//! use fiatlux_proto::{Message, decode};
//!
//! let action = Action { step: 7, joint_target: vec![0.0; 29], ..Action::default() };
//! let bytes = action.encode_to_vec();
//! assert_eq!(decode::<Action>(&bytes, MAX_CLIENT_MESSAGE), Ok(action));
//!
//! // Whatever arrives is refused with the reason, never half read.
//! let error = decode::<Action>(&bytes[..9], MAX_CLIENT_MESSAGE).unwrap_err();
//! assert!(error.to_string().contains("Action"), "{error}");
//! assert_eq!(ServerKeys::new("lab").session("42").action(), "fiatlux/v3/lab/s/42/action");
//! ```
mod again;
mod body_command;
mod decode;
mod encode;
pub mod keys;
pub mod limits;
mod nearest;
mod observation;
mod proprioception;
mod refusal;
mod sensor;
mod text;
mod version;

pub use body_command::{BodyCommand, NOMINAL_HEIGHT};
pub use decode::{DecodeError, decode, decode_onto};
pub use encode::{Encode, encode};
pub use nearest::did_you_mean;
pub use observation::{ObservationLayout, TermError, is_of_images};
pub use proprioception::Proprioception;
pub use prost::Message;
pub use prost::bytes::Bytes;
pub use text::{count, is_unseen, plain, plain_lines};
pub use version::{PROTOCOL, is_compatible};

/// The messages of the service.
#[allow(missing_docs, clippy::large_enum_variant)]
pub mod v3 {
    include!(concat!(env!("OUT_DIR"), "/fiatlux.v3.rs"));
}

/// Foxglove's well-known messages, as far as bags use them.
#[allow(missing_docs)]
pub mod foxglove {
    include!(concat!(env!("OUT_DIR"), "/foxglove.rs"));
}

pub use prost_types::{Duration, Timestamp};

/// All messages as a protobuf `FileDescriptorSet` with everything that they import: the schema that bags carry.
pub const DESCRIPTORS: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/descriptors.bin"));

/// The cause in an [`EpisodeEnd`](v3::EpisodeEnd) of an episode that no row ended: its client or its server cut it short.
pub const ABORTED: &str = "aborted";

/// The cause in an [`EpisodeEnd`](v3::EpisodeEnd) of a take that its operator ended.
pub const STOPPED: &str = "stopped";

/// Number of an encoded [`StepRecord`](v3::StepRecord), without the rest being read. Its field comes first; 0 is left out.
pub fn record_seq(mut record: &[u8]) -> u64 {
    match record.split_off_first() {
        Some(0x08) => prost::encoding::decode_varint(&mut record).unwrap_or_default(),
        _ => 0,
    }
}

/// Encoding of a payload, by the message's name: `application/protobuf;fiatlux.v3.Action`.
pub fn encoding(message: &str) -> String {
    format!("application/protobuf;fiatlux.v3.{message}")
}
