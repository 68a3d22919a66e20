//! Reads messages that may come from anyone.

use std::collections::BTreeMap;
use std::sync::OnceLock;

use prost::encoding::{DecodeContext, decode_key, skip_field};
use prost::{Message, Name};
use prost_types::FileDescriptorSet;
use thiserror::Error;

use crate::{DESCRIPTORS, PROTOCOL};

/// Why bytes were refused.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum DecodeError {
    /// Longer than the limit.
    #[error("{message} has {length} bytes; the limit is {limit}")]
    Size {
        /// Name of the message.
        message: &'static str,
        /// Bytes.
        length: usize,
        /// Bytes.
        limit: usize,
    },
    /// No protobuf of this message.
    #[error("not a {message}: {source}")]
    Malformed {
        /// Name of the message.
        message: &'static str,
        /// What prost says.
        #[source]
        source: prost::DecodeError,
    },
    /// A field that this version does not know: what it asks for would silently not happen.
    #[error("{message} has a field with number {number}, which this version does not know; use messages of {PROTOCOL}")]
    UnknownField {
        /// Name of the message.
        message: &'static str,
        /// Field number.
        number: u32,
    },
}

/// Reads a message of at most `limit` bytes. Fields that this version does not know are refused, not passed over.
///
/// # Errors
/// [`DecodeError`]: too long, no such message, or an unknown field.
pub fn decode<M: Message + Name + Default>(bytes: &[u8], limit: usize) -> Result<M, DecodeError> {
    let message = M::NAME;
    if bytes.len() > limit {
        return Err(DecodeError::Size { message, length: bytes.len(), limit });
    }
    let malformed = |source| DecodeError::Malformed { message, source };
    let decoded = M::decode(bytes).map_err(malformed)?;
    let known = field_numbers(&M::full_name());
    let mut rest = bytes;
    while !rest.is_empty() {
        let (number, wire_type) = decode_key(&mut rest).map_err(malformed)?;
        if !known.contains(&number) {
            return Err(DecodeError::UnknownField { message, number });
        }
        skip_field(wire_type, number, &mut rest, DecodeContext::default()).map_err(malformed)?;
    }
    Ok(decoded)
}

/// Field numbers of a message of ours, by its full name.
fn field_numbers(full_name: &str) -> &'static [u32] {
    static NUMBERS: OnceLock<BTreeMap<String, Vec<u32>>> = OnceLock::new();
    let numbers = NUMBERS.get_or_init(|| {
        let set = FileDescriptorSet::decode(DESCRIPTORS).unwrap_or_default();
        let messages = set.file.into_iter().flat_map(|file| {
            let package = file.package.unwrap_or_default();
            file.message_type.into_iter().map(move |message| (package.clone(), message))
        });
        let entry = |(package, message): (String, prost_types::DescriptorProto)| {
            let numbers = message.field.iter().map(|field| field.number.unwrap_or_default() as u32).collect();
            (format!("{package}.{}", message.name.unwrap_or_default()), numbers)
        };
        messages.map(entry).collect()
    });
    numbers.get(full_name).map_or(&[], Vec::as_slice)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::v1::{Action, CloseRequest, OpenRequest, State};

    #[test]
    fn a_message_reads_back() {
        let action = Action { episode: 1, step: 7, action: vec![0.5; 53], joint_target: vec![] };
        assert_eq!(decode::<Action>(&action.encode_to_vec(), 1000), Ok(action));
        assert_eq!(decode::<CloseRequest>(&[], 0), Ok(CloseRequest {}));
    }

    #[test]
    fn refusals_say_what_is_wrong() {
        let bytes = Action { step: 7, ..Action::default() }.encode_to_vec();
        let error = |bytes: &[u8]| decode::<Action>(bytes, 4).expect_err("refused").to_string();
        assert_eq!(error(&[0; 10]), "Action has 10 bytes; the limit is 4");
        assert!(error(&[0xff, 0xff, 0xff]).starts_with("not a Action: "));
        // Field 9, a varint.
        let unknown = [&bytes[..], &[0x48, 0x01]].concat();
        assert!(error(&unknown).starts_with("Action has a field with number 9, which this version does not know"));
    }

    /// Whatever bytes come, there is an answer.
    #[test]
    fn random_bytes_are_refused_or_read() {
        let mut state = 1_u64;
        for length in 0..2000 {
            let bytes: Vec<u8> = (0..length % 97)
                .map(|_| {
                    state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
                    (state >> 56) as u8
                })
                .collect();
            let _ = decode::<OpenRequest>(&bytes, 1 << 20);
            let _ = decode::<Action>(&bytes, 1 << 20);
            let _ = decode::<State>(&bytes, 1 << 20);
        }
    }

    #[test]
    fn every_message_is_described() {
        for name in ["fiatlux.v1.Action", "fiatlux.v1.OpenRequest", "fiatlux.v1.TruthAck", "foxglove.SceneUpdate"] {
            assert!(!field_numbers(name).is_empty(), "{name}");
        }
    }
}
