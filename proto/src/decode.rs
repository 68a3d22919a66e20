//! Reads messages that may come from anyone.

use std::collections::BTreeMap;
use std::sync::OnceLock;

use prost::encoding::{DecodeContext, WireType, decode_key, decode_varint, skip_field};
use prost::{Message, Name};
use prost_types::field_descriptor_proto::{Label, Type};
use prost_types::{DescriptorProto, FileDescriptorSet};
use thiserror::Error;

use crate::{DESCRIPTORS, PROTOCOL};

/// Why bytes were refused.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[allow(missing_docs)] // The messages say it.
pub enum DecodeError {
    #[error("{message} has {length} bytes; the limit is {limit}")]
    Size { message: &'static str, length: usize, limit: usize },
    #[error("cannot decode as {message}: {reason}")]
    Malformed { message: &'static str, reason: String },
    #[error("{message} has a field with number {number}, which this version does not know; use messages of {PROTOCOL}")]
    UnknownField { message: String, number: u32 },
}

/// Reads a message of at most `limit` bytes. Fields that this version does not know are refused, not ignored.
///
/// # Errors
/// [`DecodeError`]: too long, no such message, or an unknown field.
pub fn decode<M: Message + Name + Default>(bytes: &[u8], limit: usize) -> Result<M, DecodeError> {
    decode_onto(M::default(), bytes, limit)
}

/// The same into an empty message, whose lists may have room already.
///
/// # Errors
/// As for [`decode`].
pub fn decode_onto<M: Message + Name>(mut empty: M, bytes: &[u8], limit: usize) -> Result<M, DecodeError> {
    let message = M::NAME;
    if bytes.len() > limit {
        return Err(DecodeError::Size { message, length: bytes.len(), limit });
    }
    let malformed = |error: prost::DecodeError| DecodeError::Malformed { message, reason: error.to_string() };
    empty.merge(bytes).map_err(malformed)?;
    check_fields(bytes, &M::full_name()).map_err(|error| match error {
        FieldError::Malformed(error) => malformed(error),
        FieldError::Unknown { path, number } => {
            DecodeError::UnknownField { message: format!("{message}{path}"), number }
        }
    })?;
    Ok(empty)
}

enum FieldError {
    Malformed(prost::DecodeError),
    /// In the message at that path of fields.
    Unknown {
        path: String,
        number: u32,
    },
}

/// Finds the first field that a message or one within it does not have.
fn check_fields(mut bytes: &[u8], full_name: &str) -> Result<(), FieldError> {
    let Some(fields) = messages().get(full_name) else { return Ok(()) };
    while !bytes.is_empty() {
        let (number, wire_type) = decode_key(&mut bytes).map_err(FieldError::Malformed)?;
        let field = fields.get(&number);
        let field = field.ok_or_else(|| FieldError::Unknown { path: String::new(), number })?;
        match &field.message {
            Some(inner) if wire_type == WireType::LengthDelimited => {
                let length = decode_varint(&mut bytes).map_err(FieldError::Malformed)?;
                // The message was decoded before: its lengths are right.
                let (within, rest) = bytes.split_at(bytes.len().min(length as usize));
                check_fields(within, inner).map_err(|error| match error {
                    FieldError::Unknown { path, number } => {
                        FieldError::Unknown { path: format!(".{}{path}", field.name), number }
                    }
                    malformed => malformed,
                })?;
                bytes = rest;
            }
            _ => skip_field(wire_type, number, &mut bytes, DecodeContext::default()).map_err(FieldError::Malformed)?,
        }
    }
    Ok(())
}

pub(crate) struct Field {
    pub name: String,
    pub kind: Type,
    pub is_repeated: bool,
    /// Full name of the message that it holds.
    pub message: Option<String>,
}

/// The fields of all messages by number, by the message's full name.
pub(crate) fn messages() -> &'static BTreeMap<String, BTreeMap<u32, Field>> {
    static MESSAGES: OnceLock<BTreeMap<String, BTreeMap<u32, Field>>> = OnceLock::new();
    MESSAGES.get_or_init(|| {
        let set = FileDescriptorSet::decode(DESCRIPTORS).unwrap_or_default();
        let mut messages = BTreeMap::new();
        for file in set.file {
            let package = file.package.unwrap_or_default();
            file.message_type.into_iter().for_each(|message| describe(&package, message, &mut messages));
        }
        messages
    })
}

/// Adds a message and those defined within it.
fn describe(scope: &str, message: DescriptorProto, messages: &mut BTreeMap<String, BTreeMap<u32, Field>>) {
    let full_name = format!("{scope}.{}", message.name());
    for nested in message.nested_type {
        describe(&full_name, nested, messages);
    }
    let fields = message.field.into_iter().map(|field| {
        let kind = field.r#type();
        let message = (kind == Type::Message).then(|| field.type_name().trim_start_matches('.').to_owned());
        let is_repeated = field.label() == Label::Repeated;
        (field.number() as u32, Field { name: field.name().into(), kind, is_repeated, message })
    });
    messages.insert(full_name, fields.collect());
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::v3::{Action, CloseRequest, OpenRequest, State};

    #[test]
    fn a_message_reads_back() {
        let action = Action { episode: 1, step: 7, action: vec![0.5; 53], ..Action::default() };
        assert_eq!(decode::<Action>(&action.encode_to_vec(), 1000), Ok(action));
        assert_eq!(decode::<CloseRequest>(&[], 0), Ok(CloseRequest {}));
    }

    #[test]
    fn refusals_say_what_is_wrong() {
        let bytes = Action { step: 7, ..Action::default() }.encode_to_vec();
        let error = |bytes: &[u8]| decode::<Action>(bytes, 4).expect_err("refused").to_string();
        assert_eq!(error(&[0; 10]), "Action has 10 bytes; the limit is 4");
        assert!(error(&[0xff, 0xff, 0xff]).starts_with("cannot decode as Action: "));
        // Field 9, a varint.
        let unknown = [&bytes[..], &[0x48, 0x01]].concat();
        assert!(error(&unknown).starts_with("Action has a field with number 9, which this version does not know"));
    }

    #[test]
    fn unknown_fields_are_found_within_messages() {
        // Field 9, a message; in it field 15, a varint.
        let unknown = [0x4a, 0x02, 0x78, 0x01];
        let error = decode::<OpenRequest>(&unknown, 100).expect_err("refused").to_string();
        assert!(error.starts_with("OpenRequest.randomization has a field with number 15"), "{error}");
        // A map's entry is a message of its own.
        let request = OpenRequest { thresholds: [("a".into(), 1.0)].into(), ..OpenRequest::default() };
        assert_eq!(decode::<OpenRequest>(&request.encode_to_vec(), 100), Ok(request));
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
        for name in ["fiatlux.v3.Action", "fiatlux.v3.OpenRequest", "fiatlux.v3.StepRecordAck", "foxglove.SceneUpdate"]
        {
            assert!(messages().contains_key(name), "{name}");
        }
    }
}
