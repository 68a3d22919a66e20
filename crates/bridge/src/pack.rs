//! MessagePack with limits on size and depth.

use rmpv::Value;

use crate::BridgeError;

const MAX_DEPTH: usize = 32;

pub(crate) fn encode(value: &Value) -> Vec<u8> {
    let mut bytes = Vec::new();
    // Writing to memory cannot fail.
    let _ = rmpv::encode::write_value(&mut bytes, value);
    bytes
}

/// Decodes one value, which must use all of the bytes.
pub(crate) fn decode(what: &str, bytes: &[u8]) -> Result<Value, BridgeError> {
    let mut rest = bytes;
    let value = rmpv::decode::read_value_with_max_depth(&mut rest, MAX_DEPTH)
        .map_err(|error| BridgeError::malformed(what, format!("it is not MessagePack: {error}")))?;
    if rest.is_empty() {
        return Ok(value);
    }
    Err(BridgeError::malformed(what, format!("{} bytes follow its end", rest.len())))
}

/// A text as a key or value of a map.
pub(crate) fn text(text: &str) -> Value {
    Value::from(text)
}

pub(crate) fn map<const N: usize>(entries: [(&str, Value); N]) -> Value {
    Value::Map(entries.into_iter().map(|(key, value)| (text(key), value)).collect())
}

/// Reads a text, which some servers send as bytes.
pub(crate) fn as_text(value: &Value) -> Option<&str> {
    match value {
        Value::String(text) => text.as_str(),
        Value::Binary(bytes) => std::str::from_utf8(bytes).ok(),
        _ => None,
    }
}

pub(crate) fn entry<'a>(value: &'a Value, name: &str) -> Option<&'a Value> {
    value.as_map()?.iter().find(|(key, _)| as_text(key) == Some(name)).map(|(_, value)| value)
}

/// Reads bytes, which old packers send as text.
pub(crate) fn as_bytes(value: &Value) -> Option<&[u8]> {
    match value {
        Value::Binary(bytes) => Some(bytes),
        Value::String(text) => Some(text.as_bytes()),
        _ => None,
    }
}

/// Describes a value for an error: its type, and the first keys of a map.
pub(crate) fn described(value: &Value) -> String {
    const MAX_KEYS: usize = 8;
    match value {
        Value::Nil => "nil".into(),
        Value::Boolean(_) | Value::Integer(_) | Value::F32(_) | Value::F64(_) => "a number".into(),
        Value::String(_) => "text".into(),
        Value::Binary(bytes) => format!("{} bytes", bytes.len()),
        Value::Array(parts) => format!("a list of {}", parts.len()),
        Value::Ext(kind, _) => format!("an extension of type {kind}"),
        Value::Map(entries) => {
            let key = |(key, _): &(Value, Value)| match as_text(key) {
                Some(name) => format!("{:?}", name.chars().take(40).collect::<String>()),
                None => described(key),
            };
            let keys: Vec<String> = entries.iter().take(MAX_KEYS).map(key).collect();
            let more = if entries.len() > MAX_KEYS { ", ..." } else { "" };
            format!("a map of {} keys: {}{more}", entries.len(), keys.join(", "))
        }
    }
}
