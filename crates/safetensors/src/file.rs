use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::SafetensorsError;

/// Maximum length of a header; that of a ResNet-18 has some 12 kB.
const HEADER_LIMIT: u64 = 1 << 20;

const F32: &str = "F32";

const METADATA: &str = "__metadata__";

/// A tensor in the header. The fields are in the order of their names, which `serde_json` may or may not keep: so the
/// bytes of a file depend on none of its features.
#[derive(Debug, Deserialize, Serialize)]
struct Entry {
    data_offsets: [u64; 2],
    dtype: String,
    shape: Vec<u64>,
}

/// A file's header; its tensors are not read yet.
#[derive(Debug)]
pub struct File<'a> {
    entries: BTreeMap<String, Entry>,
    metadata: BTreeMap<String, String>,
    data: &'a [u8],
}

impl<'a> File<'a> {
    /// Reads the header. Positions of tensors are checked when they are read.
    pub fn parse(bytes: &'a [u8]) -> Result<Self, SafetensorsError> {
        let wrong = |problem| SafetensorsError::Format { problem };
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
        let metadata = values.remove(METADATA).map_or_else(|| Ok(BTreeMap::new()), serde_json::from_value);
        let metadata = metadata.map_err(|error| wrong(format!("expected texts as {METADATA}, found: {error}")))?;
        let entry = |(name, value): (String, _)| match serde_json::from_value(value) {
            Ok(entry) => Ok((name, entry)),
            Err(error) => Err(wrong(format!("expected dtype, shape and data_offsets of '{name}', found: {error}"))),
        };
        Ok(Self { entries: values.into_iter().map(entry).collect::<Result<_, _>>()?, metadata, data })
    }

    /// Names of all tensors, sorted.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.entries.keys().map(String::as_str)
    }

    /// The metadata under this name.
    pub fn metadata(&self, name: &str) -> Option<&str> {
        self.metadata.get(name).map(String::as_str)
    }

    /// The numbers of a tensor, which must have this shape. They may be NaN or infinite.
    pub fn tensor(&self, name: &str, shape: &[usize]) -> Result<Vec<f32>, SafetensorsError> {
        let tensor = || name.to_owned();
        let Some(entry) = self.entries.get(name) else {
            return Err(SafetensorsError::Missing { tensor: tensor(), shape: shape.to_vec() });
        };
        if entry.dtype != F32 {
            return Err(SafetensorsError::Type { tensor: tensor(), found: entry.dtype.clone() });
        }
        if !entry.shape.iter().copied().eq(shape.iter().map(|&side| side as u64)) {
            let (expected, found) = (shape.to_vec(), entry.shape.clone());
            return Err(SafetensorsError::Shape { tensor: tensor(), expected, found });
        }
        let expected = 4 * shape.iter().product::<usize>() as u64;
        let [begin, end] = entry.data_offsets;
        let data = self.data.len() as u64;
        if end > data || end.checked_sub(begin) != Some(expected) {
            return Err(SafetensorsError::Extent { tensor: tensor(), expected, data, begin, end });
        }
        let bytes = &self.data[begin as usize..end as usize];
        Ok(bytes.as_chunks().0.iter().map(|&number| f32::from_le_bytes(number)).collect())
    }
}

/// The bytes of a file of f32 tensors, each a name, a shape and its numbers: the data in this order, the header sorted
/// by name.
pub fn write<'a>(tensors: impl Iterator<Item = (String, Vec<usize>, &'a [f32])>) -> Vec<u8> {
    let mut entries = BTreeMap::new();
    let mut data = Vec::new();
    for (name, shape, numbers) in tensors {
        let begin = data.len() as u64;
        data.extend(numbers.iter().flat_map(|number| number.to_le_bytes()));
        let shape = shape.into_iter().map(|side| side as u64).collect();
        entries.insert(name, Entry { dtype: F32.into(), shape, data_offsets: [begin, data.len() as u64] });
    }
    let mut header = serde_json::json!(entries).to_string().into_bytes();
    // The format requires data to start at a multiple of 8.
    header.resize(header.len().next_multiple_of(8), b' ');
    let mut bytes = (header.len() as u64).to_le_bytes().to_vec();
    bytes.append(&mut header);
    bytes.append(&mut data);
    bytes
}
