//! The service's language: messages, key expressions, limits and the version of the protocol.
//!
//! Messages are protobuf (`proto/proto/fiatlux/v3/*.proto`, where every field is described); [`v3`] has them as Rust
//! types. [`foxglove`] has the well-known messages by which a viewer shows a bag. Nothing here does I/O.
mod decode;
pub mod keys;
pub mod limits;
mod observation;
mod sensor;
mod version;

pub use decode::{DecodeError, decode};
pub use observation::{ObservationLayout, TermError, is_of_images};
pub use prost::Message;
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

/// Encoding of a payload, by the message's name: `application/protobuf;fiatlux.v3.Action`.
pub fn encoding(message: &str) -> String {
    format!("application/protobuf;fiatlux.v3.{message}")
}
