use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::SafetensorsError;

/// Maximum length of a header; that of a ResNet-18 has some 12 kB.
const HEADER_LIMIT: u64 = 1 << 20;

/// Types of numbers that are read, with the bytes of each.
const TYPES: [(&str, usize); 2] = [("F32", 4), ("F16", 2)];

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
        let Some((_, width)) = TYPES.iter().find(|(name, _)| *name == entry.dtype) else {
            return Err(SafetensorsError::Type { tensor: tensor(), found: entry.dtype.clone() });
        };
        if !entry.shape.iter().copied().eq(shape.iter().map(|&side| side as u64)) {
            let (expected, found) = (shape.to_vec(), entry.shape.clone());
            return Err(SafetensorsError::Shape { tensor: tensor(), expected, found });
        }
        let expected = (width * shape.iter().product::<usize>()) as u64;
        let [begin, end] = entry.data_offsets;
        let data = self.data.len() as u64;
        if end > data || end.checked_sub(begin) != Some(expected) {
            return Err(SafetensorsError::Extent { tensor: tensor(), expected, data, begin, end });
        }
        let bytes = &self.data[begin as usize..end as usize];
        Ok(match width {
            2 => bytes.as_chunks().0.iter().map(|&number| of_half(u16::from_le_bytes(number))).collect(),
            _ => bytes.as_chunks().0.iter().map(|&number| f32::from_le_bytes(number)).collect(),
        })
    }
}

/// The number that these bits are in half precision (IEEE 754 binary16).
fn of_half(bits: u16) -> f32 {
    const SMALLEST: f32 = 1.0 / (1 << 24) as f32;
    let (sign, exponent, fraction) =
        (u32::from(bits & 0x8000) << 16, u32::from(bits >> 10 & 0x1f), u32::from(bits & 0x3ff));
    let magnitude = match exponent {
        0 => (fraction as f32 * SMALLEST).to_bits(),
        31 => 0x7f80_0000 | fraction << 13,
        _ => (exponent + 112) << 23 | fraction << 13,
    };
    f32::from_bits(sign | magnitude)
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
        entries.insert(name, Entry { dtype: TYPES[0].0.into(), shape, data_offsets: [begin, data.len() as u64] });
    }
    let mut header = serde_json::json!(entries).to_string().into_bytes();
    // The format requires data to start at a multiple of 8.
    header.resize(header.len().next_multiple_of(8), b' ');
    let mut bytes = (header.len() as u64).to_le_bytes().to_vec();
    bytes.append(&mut header);
    bytes.append(&mut data);
    bytes
}

#[cfg(test)]
mod tests {
    use super::of_half;

    #[test]
    fn halves_are_their_numbers() {
        for (bits, number) in [
            (0x0000, 0.0),
            (0x3c00, 1.0),
            (0xc000, -2.0),
            (0x3555, 0.333_251_95),
            (0x7bff, 65_504.0),
            (0x0001, power_of_two(-24)),
            (0x83ff, -1023.0 * power_of_two(-24)),
            (0x0400, power_of_two(-14)),
            (0x7c00, f32::INFINITY),
            (0xfc00, f32::NEG_INFINITY),
        ] {
            assert_eq!(of_half(bits), number, "{bits:#06x}");
        }
        assert!(of_half(0x7e00).is_nan() && of_half(0x8000).is_sign_negative());
    }

    fn power_of_two(exponent: i32) -> f32 {
        f32::from_bits(((exponent + 127) as u32) << 23)
    }
}
