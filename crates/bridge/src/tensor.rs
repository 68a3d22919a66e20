//! Arrays of numbers: their elements, and their encodings.

mod forms;
mod npy;

use crate::BridgeError;
pub use forms::Form;

const MAX_DIMENSIONS: usize = 8;
const MAX_ELEMENTS: usize = 4 << 20;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Dtype {
    Bool,
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    I64,
    U64,
    /// Used as f64.
    F16,
    F32,
    F64,
}

impl Dtype {
    /// Name in NumPy's short and long notation, and size in bytes.
    const ALL: [(Self, &'static str, &'static str, usize); 12] = [
        (Self::Bool, "|b1", "bool", 1),
        (Self::I8, "|i1", "int8", 1),
        (Self::U8, "|u1", "uint8", 1),
        (Self::I16, "<i2", "int16", 2),
        (Self::U16, "<u2", "uint16", 2),
        (Self::I32, "<i4", "int32", 4),
        (Self::U32, "<u4", "uint32", 4),
        (Self::I64, "<i8", "int64", 8),
        (Self::U64, "<u8", "uint64", 8),
        (Self::F16, "<f2", "float16", 2),
        (Self::F32, "<f4", "float32", 4),
        (Self::F64, "<f8", "float64", 8),
    ];

    /// Its name in NumPy's short notation, such as `<f4`.
    pub fn name(self) -> &'static str {
        Self::ALL[self as usize].1
    }

    pub fn size(self) -> usize {
        Self::ALL[self as usize].3
    }

    /// Finds a type by its name in either notation; also says whether its elements are big-endian.
    fn by_name(name: &str) -> Result<(Self, bool), BridgeError> {
        let bare = name.strip_prefix(['<', '>', '|', '=']).unwrap_or(name);
        let found = Self::ALL.iter().find(|(_, short, long, _)| short[1..] == *bare || *long == name);
        found.map(|(dtype, ..)| (*dtype, name.starts_with('>'))).ok_or_else(|| {
            let (name, known) = (name.chars().take(40).collect::<String>(), Self::ALL.map(|(_, short, ..)| short));
            let problem = format!("its elements are {name:?}; send one of {}, or float32", known.join(", "));
            BridgeError::malformed("an array", problem)
        })
    }
}

/// An array: elements in C order, little-endian. The number of bytes always fits the shape.
#[derive(Debug, Clone, PartialEq)]
pub struct Tensor {
    dtype: Dtype,
    shape: Vec<usize>,
    data: Vec<u8>,
}

impl Tensor {
    /// Makes an array, and checks that bytes and shape match.
    pub fn new(dtype: Dtype, shape: Vec<usize>, data: Vec<u8>) -> Result<Self, BridgeError> {
        let wrong = |problem| Err(BridgeError::malformed("an array", problem));
        if shape.len() > MAX_DIMENSIONS {
            return wrong(format!("it has {} dimensions; the limit is {MAX_DIMENSIONS}", shape.len()));
        }
        let count = shape.iter().try_fold(1_usize, |count, side| count.checked_mul(*side));
        let Some(count) = count.filter(|count| *count <= MAX_ELEMENTS) else {
            return wrong(format!("its shape is {shape:?}; the limit is {MAX_ELEMENTS} elements"));
        };
        let expected = count * dtype.size();
        if data.len() != expected {
            let found = data.len();
            return wrong(format!("{} of shape {shape:?} takes {expected} bytes; it has {found}", dtype.name()));
        }
        Ok(Self { dtype, shape, data })
    }

    /// As [`Tensor::new`], with elements of a type that is named as NumPy does, in either byte order.
    fn named(dtype: &str, shape: Vec<usize>, mut data: Vec<u8>) -> Result<Self, BridgeError> {
        let (dtype, is_big_endian) = Dtype::by_name(dtype)?;
        if is_big_endian {
            data.chunks_exact_mut(dtype.size()).for_each(<[u8]>::reverse);
        }
        Self::new(dtype, shape, data)
    }

    pub fn f32(shape: Vec<usize>, numbers: &[f32]) -> Result<Self, BridgeError> {
        Self::new(Dtype::F32, shape, numbers.iter().flat_map(|number| number.to_le_bytes()).collect())
    }

    pub fn u8(shape: Vec<usize>, data: Vec<u8>) -> Result<Self, BridgeError> {
        Self::new(Dtype::U8, shape, data)
    }

    pub fn dtype(&self) -> Dtype {
        self.dtype
    }

    pub fn shape(&self) -> &[usize] {
        &self.shape
    }

    /// All elements as bytes in C order, little-endian.
    pub fn data(&self) -> &[u8] {
        &self.data
    }

    /// All elements as f64, in C order.
    pub fn numbers(&self) -> Vec<f64> {
        fn each<const N: usize>(data: &[u8], read: impl Fn([u8; N]) -> f64) -> Vec<f64> {
            data.as_chunks::<N>().0.iter().map(|bytes| read(*bytes)).collect()
        }
        match self.dtype {
            Dtype::Bool | Dtype::U8 => self.data.iter().map(|&byte| f64::from(byte)).collect(),
            Dtype::I8 => each(&self.data, |bytes| f64::from(i8::from_le_bytes(bytes))),
            Dtype::I16 => each(&self.data, |bytes| f64::from(i16::from_le_bytes(bytes))),
            Dtype::U16 => each(&self.data, |bytes| f64::from(u16::from_le_bytes(bytes))),
            Dtype::U32 => each(&self.data, |bytes| f64::from(u32::from_le_bytes(bytes))),
            Dtype::U64 => each(&self.data, |bytes| u64::from_le_bytes(bytes) as f64),
            Dtype::I32 => each(&self.data, |bytes| f64::from(i32::from_le_bytes(bytes))),
            Dtype::I64 => each(&self.data, |bytes| i64::from_le_bytes(bytes) as f64),
            Dtype::F16 => each(&self.data, |bytes| half(u16::from_le_bytes(bytes))),
            Dtype::F32 => each(&self.data, |bytes| f64::from(f32::from_le_bytes(bytes))),
            Dtype::F64 => each(&self.data, f64::from_le_bytes),
        }
    }
}

/// Converts a 16-bit float (IEEE 754 binary16).
fn half(bits: u16) -> f64 {
    let sign = if bits >> 15 == 1 { -1.0 } else { 1.0 };
    let (exponent, mantissa) = (i32::from(bits >> 10 & 0x1f), f64::from(bits & 0x3ff));
    sign * match exponent {
        0 => libm::ldexp(mantissa, -24),
        0x1f if mantissa == 0.0 => f64::INFINITY,
        0x1f => f64::NAN,
        _ => libm::ldexp(1024.0 + mantissa, exponent - 25),
    }
}

#[cfg(test)]
pub(crate) mod tests;
