//! Encodings of arrays in MessagePack. Every published client and server writes one of them, with texts or bytes as
//! keys.

use rmpv::Value;

use super::{Dtype, MAX_DIMENSIONS, MAX_ELEMENTS, Tensor};
use crate::BridgeError;
use crate::pack::{as_bytes, as_text, described, entry, map, text};

/// An encoding of an array in MessagePack.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Form {
    /// A map with a complete `.npy` file: GR00T N1.5, N1.6 and early N1.7.
    Npy,
    /// The Python package `msgpack-numpy`: GR00T N1.7.
    MsgpackNumpy,
    /// The Python package `openpi-client`.
    Openpi,
}

impl Tensor {
    /// Encodes the array, byte for byte as the Python packages do.
    pub fn write(&self, form: Form) -> Value {
        let shape = || Value::Array(self.shape.iter().map(|&side| Value::from(side as u64)).collect());
        let data = || Value::Binary(self.data.clone());
        let byte_keys = |entries: Vec<(&str, Value)>| {
            Value::Map(entries.into_iter().map(|(key, value)| (Value::Binary(key.into()), value)).collect())
        };
        let dtype = text(self.dtype.name());
        match form {
            Form::Npy => map([("__ndarray_class__", Value::from(true)), ("as_npy", Value::Binary(self.to_npy()))]),
            Form::MsgpackNumpy => byte_keys(vec![
                ("nd", Value::from(true)),
                ("type", dtype),
                ("kind", Value::Binary(Vec::new())),
                ("shape", shape()),
                ("data", data()),
            ]),
            Form::Openpi => byte_keys(vec![
                ("__ndarray__", Value::from(true)),
                ("data", data()),
                ("dtype", dtype),
                ("shape", shape()),
            ]),
        }
    }

    /// Decodes an array, or a single number, in any form: those of [`Form`], and nested lists. `what` is its name in
    /// errors.
    pub fn read(what: &str, value: &Value) -> Result<Self, BridgeError> {
        let read = match value {
            Value::Map(_) => Self::of_map(value),
            Value::Array(_) | Value::Integer(_) | Value::F32(_) | Value::F64(_) | Value::Boolean(_) => {
                Self::of_lists(value)
            }
            other => Err(wrong(&format!("it is {}", described(other)))),
        };
        read.map_err(|error| match error {
            BridgeError::Malformed { problem, .. } => BridgeError::malformed(what, problem),
            other => other,
        })
    }

    fn of_map(value: &Value) -> Result<Self, BridgeError> {
        if entry(value, "__ndarray_class__").is_some() {
            let file = entry(value, "as_npy").and_then(as_bytes);
            return Self::of_npy(file.ok_or_else(|| wrong("it has no bytes 'as_npy'"))?);
        }
        if entry(value, "__ndarray__").is_some() {
            return Self::of_parts(value, "dtype", true);
        }
        if entry(value, "__npgeneric__").is_some() {
            return Self::of_lists(entry(value, "data").unwrap_or(&Value::Nil));
        }
        if let Some(is_array) = entry(value, "nd") {
            return match entry(value, "kind").and_then(as_text) {
                Some("O") => Err(wrong("it is pickled, and pickles are not read; send plain numbers")),
                Some("V") => Err(wrong("its elements are records or bfloat16; send float32")),
                _ => Self::of_parts(value, "type", *is_array != Value::from(false)),
            };
        }
        Err(wrong(&format!("it is {}", described(value))))
    }

    /// Decodes a map of type, shape and data.
    fn of_parts(value: &Value, dtype: &str, has_shape: bool) -> Result<Self, BridgeError> {
        let part = |name: &str| entry(value, name).ok_or_else(|| wrong(&format!("it has no '{name}'")));
        let name = as_text(part(dtype)?).ok_or_else(|| wrong("its elements are records; send float32"))?;
        let shape: &[Value] = match has_shape {
            true => part("shape")?.as_array().ok_or_else(|| wrong("its 'shape' is not a list"))?,
            false => &[],
        };
        let sides = shape.iter().map(|side| side.as_u64().and_then(|side| usize::try_from(side).ok()));
        let shape = sides.collect::<Option<_>>().ok_or_else(|| wrong("its 'shape' is not of whole numbers"))?;
        let data = as_bytes(part("data")?).ok_or_else(|| wrong("its 'data' are not bytes"))?;
        Self::named(name, shape, data.to_vec())
    }

    /// Decodes nested lists, the innermost of numbers or of arrays.
    fn of_lists(value: &Value) -> Result<Self, BridgeError> {
        let mut numbers = Vec::new();
        let shape = flatten(value, &mut numbers)?;
        Self::new(Dtype::F64, shape, numbers.iter().flat_map(|number| number.to_le_bytes()).collect())
    }
}

/// Appends all numbers of nested lists, and returns their shape.
fn flatten(value: &Value, numbers: &mut Vec<f64>) -> Result<Vec<usize>, BridgeError> {
    match value {
        Value::Array(parts) => {
            let mut inner = None;
            for part in parts {
                let shape = flatten(part, numbers)?;
                if *inner.get_or_insert_with(|| shape.clone()) != shape {
                    return Err(wrong("it is a list of parts with different shapes"));
                }
                if shape.len() >= MAX_DIMENSIONS || numbers.len() > MAX_ELEMENTS {
                    return Err(wrong("it is a list with too many dimensions or elements"));
                }
            }
            Ok([vec![parts.len()], inner.unwrap_or_default()].concat())
        }
        Value::Map(_) => {
            let tensor = Tensor::of_map(value)?;
            numbers.extend(tensor.numbers());
            Ok(tensor.shape)
        }
        Value::Boolean(flag) => {
            numbers.push(f64::from(u8::from(*flag)));
            Ok(Vec::new())
        }
        other => {
            let number = other.as_f64().ok_or_else(|| wrong(&format!("it has {} in it", described(other))))?;
            numbers.push(number);
            Ok(Vec::new())
        }
    }
}

fn wrong(problem: &str) -> BridgeError {
    BridgeError::malformed("an array", problem)
}
