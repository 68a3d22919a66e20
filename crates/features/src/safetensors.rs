//! The safetensors format: 8 bytes of header length (little-endian), a JSON header that gives each tensor's type, shape
//! and place, then the data (huggingface.co/docs/safetensors).

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::FeatureError;

/// The longest header that is parsed; ours has some 12 kB.
const HEADER_LIMIT: u64 = 1 << 20;

/// The one type of number that is read.
const F32: &str = "F32";

/// The key under which a file may carry remarks.
const METADATA: &str = "__metadata__";

/// What the header says of a tensor. The fields are in the order of their names, in which `serde_json` may or may not
/// write them: so the bytes of a file depend on no feature of it.
#[derive(Debug, Deserialize, Serialize)]
pub(crate) struct Entry {
    pub data_offsets: [u64; 2],
    pub dtype: String,
    pub shape: Vec<u64>,
}

/// A file's tensors, not yet read.
#[derive(Debug)]
pub(crate) struct File<'a> {
    pub entries: BTreeMap<String, Entry>,
    data: &'a [u8],
}

impl<'a> File<'a> {
    /// Reads the header. The tensors' places are checked when they are read.
    pub fn parse(bytes: &'a [u8]) -> Result<Self, FeatureError> {
        let wrong = |problem| FeatureError::Format { problem };
        let Some((length, rest)) = bytes.split_first_chunk::<8>() else {
            return Err(wrong(format!("expected 8 bytes of header length, found {} bytes in all", bytes.len())));
        };
        let length = u64::from_le_bytes(*length);
        if length > HEADER_LIMIT {
            return Err(wrong(format!("expected a header of at most {HEADER_LIMIT} bytes, found the length {length}")));
        }
        let Some((header, data)) = rest.split_at_checked(length as usize) else {
            return Err(wrong(format!("expected a header of {length} bytes, found {}: the file is cut", rest.len())));
        };
        let mut values: BTreeMap<String, serde_json::Value> = serde_json::from_slice(header)
            .map_err(|error| wrong(format!("expected a JSON object as header, found: {error}")))?;
        values.remove(METADATA);
        let entry = |(name, value): (String, _)| match serde_json::from_value(value) {
            Ok(entry) => Ok((name, entry)),
            Err(error) => Err(wrong(format!("expected dtype, shape and data_offsets of '{name}', found: {error}"))),
        };
        Ok(Self { entries: values.into_iter().map(entry).collect::<Result<_, _>>()?, data })
    }

    /// The numbers of a tensor that must be there with this shape, in f32.
    pub fn tensor(&self, name: &str, shape: &[usize]) -> Result<Vec<f32>, FeatureError> {
        let tensor = || name.to_owned();
        let Some(entry) = self.entries.get(name) else {
            return Err(FeatureError::Missing { tensor: tensor(), shape: shape.to_vec() });
        };
        if entry.dtype != F32 {
            return Err(FeatureError::Type { tensor: tensor(), found: entry.dtype.clone() });
        }
        if !entry.shape.iter().copied().eq(shape.iter().map(|&side| side as u64)) {
            let (expected, found) = (shape.to_vec(), entry.shape.clone());
            return Err(FeatureError::Shape { tensor: tensor(), expected, found });
        }
        let expected = 4 * shape.iter().product::<usize>() as u64;
        let [begin, end] = entry.data_offsets;
        let data = self.data.len() as u64;
        if end > data || end.checked_sub(begin) != Some(expected) {
            return Err(FeatureError::Extent { tensor: tensor(), expected, data, begin, end });
        }
        let bytes = &self.data[begin as usize..end as usize];
        Ok(bytes.as_chunks().0.iter().map(|&number| f32::from_le_bytes(number)).collect())
    }
}

/// A file of f32 tensors: the data in this order, the header in that of the names.
pub(crate) fn write<'a>(tensors: impl Iterator<Item = (String, Vec<usize>, &'a [f32])>) -> Vec<u8> {
    let mut entries = BTreeMap::new();
    let mut data = Vec::new();
    for (name, shape, numbers) in tensors {
        let begin = data.len() as u64;
        data.extend(numbers.iter().flat_map(|number| number.to_le_bytes()));
        let shape = shape.into_iter().map(|side| side as u64).collect();
        entries.insert(name, Entry { dtype: F32.into(), shape, data_offsets: [begin, data.len() as u64] });
    }
    let mut header = serde_json::json!(entries).to_string().into_bytes();
    // The data starts on a multiple of 8, as the format asks.
    header.resize(header.len().next_multiple_of(8), b' ');
    let mut bytes = (header.len() as u64).to_le_bytes().to_vec();
    bytes.append(&mut header);
    bytes.append(&mut data);
    bytes
}
