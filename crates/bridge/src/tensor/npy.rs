//! NumPy's file format `.npy`: reads versions 1 to 3, and writes version 1 byte for byte as NumPy does.

use super::{MAX_DIMENSIONS, Tensor};
use crate::BridgeError;

const MAGIC: &[u8; 6] = b"\x93NUMPY";
/// The data begin at a multiple of this number of bytes.
const ALIGNMENT: usize = 64;
/// NumPy leaves room for the first dimension to grow to this number of digits.
const GROWTH: usize = 21;
/// Maximum length of a header, bytes; NumPy has the same limit.
const MAX_HEADER: usize = 10_000;

impl Tensor {
    /// A complete file, in the same bytes that NumPy's `save` writes.
    pub fn to_npy(&self) -> Vec<u8> {
        let sides: Vec<String> = self.shape.iter().map(ToString::to_string).collect();
        let shape = match sides.as_slice() {
            [one] => format!("{one},"),
            sides => sides.join(", "),
        };
        let mut header = format!("{{'descr': '{}', 'fortran_order': False, 'shape': ({shape}), }}", self.dtype.name());
        let room = sides.first().map_or(0, |first| GROWTH.saturating_sub(first.len()));
        header.push_str(&" ".repeat(room));
        let used = MAGIC.len() + 4 + header.len() + 1;
        header.push_str(&" ".repeat(ALIGNMENT - used % ALIGNMENT));
        header.push('\n');
        let mut bytes = Vec::with_capacity(10 + header.len() + self.data.len());
        bytes.extend_from_slice(MAGIC);
        bytes.extend_from_slice(&[1, 0]);
        bytes.extend_from_slice(&(header.len() as u16).to_le_bytes());
        bytes.extend_from_slice(header.as_bytes());
        bytes.extend_from_slice(&self.data);
        bytes
    }

    /// Reads a file. Elements in Fortran order are rearranged to C order. Pickled objects are refused.
    pub fn of_npy(bytes: &[u8]) -> Result<Self, BridgeError> {
        let wrong = |problem: &str| BridgeError::malformed("a .npy file", problem);
        let rest = bytes.strip_prefix(MAGIC).ok_or_else(|| wrong("its first bytes are not those of the format"))?;
        let (version, rest) = rest.split_at_checked(2).ok_or_else(|| wrong("it is cut"))?;
        let size_bytes = match version[0] {
            1 => 2,
            2 | 3 => 4,
            other => return Err(wrong(&format!("it has version {other} of the format; 1 to 3 are supported"))),
        };
        let (size, rest) = rest.split_at_checked(size_bytes).ok_or_else(|| wrong("it is cut"))?;
        let size = size.iter().rev().fold(0, |size, &byte| size << 8 | usize::from(byte));
        if size > MAX_HEADER {
            return Err(wrong(&format!("its header has {size} bytes; the limit is {MAX_HEADER}")));
        }
        let (header, data) = rest.split_at_checked(size).ok_or_else(|| wrong("it is cut"))?;
        let header = std::str::from_utf8(header).map_err(|_| wrong("its header is not text"))?;
        let field = |name: &str| value(header, name).ok_or_else(|| wrong(&format!("its header has no '{name}'")));
        let descr = field("descr")?;
        let dtype = descr.trim_matches(['\'', '"']);
        if dtype.len() + 2 != descr.len() {
            return Err(wrong("its elements are records; only plain numbers are supported"));
        }
        let shape = field("shape")?.trim_matches(['(', ')']);
        let sides = shape.split(',').map(str::trim).filter(|side| !side.is_empty()).take(MAX_DIMENSIONS + 1);
        let shape = sides.map(|side| side.parse().ok()).collect::<Option<Vec<usize>>>();
        let shape = shape.ok_or_else(|| wrong("its shape is not of whole numbers"))?;
        let is_fortran = match field("fortran_order")? {
            "True" => true,
            "False" => false,
            _ => return Err(wrong("its 'fortran_order' is neither True nor False")),
        };
        let tensor = Self::named(dtype, shape, data.to_vec())?;
        Ok(if is_fortran { tensor.of_fortran() } else { tensor })
    }

    /// Rearranges elements that came with the first index fastest.
    fn of_fortran(mut self) -> Self {
        let size = self.dtype.size();
        let mut data = Vec::with_capacity(self.data.len());
        let mut index = vec![0; self.shape.len()];
        for _ in 0..self.data.len() / size.max(1) {
            let place = index.iter().zip(&self.shape).rev().fold(0, |place, (at, side)| place * side + at);
            data.extend_from_slice(&self.data[place * size..(place + 1) * size]);
            for (at, side) in index.iter_mut().zip(&self.shape).rev() {
                *at += 1;
                if *at < *side {
                    break;
                }
                *at = 0;
            }
        }
        self.data = data;
        self
    }
}

/// The text of a field in the header's dictionary; `None` if it is missing.
fn value<'a>(header: &'a str, name: &str) -> Option<&'a str> {
    let at = ["'", "\""].iter().find_map(|quote| header.find(&format!("{quote}{name}{quote}")))?;
    let rest = header[at + name.len() + 2..].trim_start().strip_prefix(':')?.trim_start();
    let end = match rest.chars().next()? {
        '(' => rest.find(')')? + 1,
        quote @ ('\'' | '"') => rest[1..].find(quote)? + 2,
        _ => rest.find([',', '}'])?,
    };
    Some(rest[..end].trim_end())
}
