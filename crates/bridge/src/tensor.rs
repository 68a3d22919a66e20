//! Arrays in the forms that model servers send: `.npy` files in a map (GR00T) and maps with byte keys (openpi).

mod npy;

use rmpv::Value;

use crate::BridgeError;
use crate::pack::{as_text, entry, map, text};

/// Largest number of dimensions of an array.
const MAX_DIMENSIONS: usize = 8;
/// Largest number of elements of an array.
const MAX_ELEMENTS: usize = 4 << 20;

/// Element types that can be read and written, little-endian.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Dtype {
    /// Boolean of one byte, NumPy's `|b1`.
    Bool,
    /// Unsigned 8-bit integer, NumPy's `|u1`.
    U8,
    /// Signed 32-bit integer, NumPy's `<i4`.
    I32,
    /// Signed 64-bit integer, NumPy's `<i8`.
    I64,
    /// 16-bit float, NumPy's `<f2`; read, and used as f64.
    F16,
    /// 32-bit float, NumPy's `<f4`.
    F32,
    /// 64-bit float, NumPy's `<f8`.
    F64,
}

impl Dtype {
    const ALL: [(Self, &'static str, usize); 7] = [
        (Self::Bool, "|b1", 1),
        (Self::U8, "|u1", 1),
        (Self::I32, "<i4", 4),
        (Self::I64, "<i8", 8),
        (Self::F16, "<f2", 2),
        (Self::F32, "<f4", 4),
        (Self::F64, "<f8", 8),
    ];

    /// Its name in NumPy's notation, such as `<f4`.
    pub fn name(self) -> &'static str {
        Self::ALL[self as usize].1
    }

    /// Size of an element in bytes.
    pub fn size(self) -> usize {
        Self::ALL[self as usize].2
    }

    fn by_name(name: &str) -> Option<Self> {
        Self::ALL.iter().find(|(_, known, _)| *known == name).map(|(dtype, ..)| *dtype)
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
    ///
    /// # Errors
    /// [`BridgeError::Malformed`]: too many dimensions or elements, or a wrong number of bytes.
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

    /// Makes an array of `<f4` elements.
    ///
    /// # Errors
    /// As for [`Tensor::new`].
    pub fn f32(shape: Vec<usize>, numbers: &[f32]) -> Result<Self, BridgeError> {
        Self::new(Dtype::F32, shape, numbers.iter().flat_map(|number| number.to_le_bytes()).collect())
    }

    /// Makes an array of `|u1` elements.
    ///
    /// # Errors
    /// As for [`Tensor::new`].
    pub fn u8(shape: Vec<usize>, data: Vec<u8>) -> Result<Self, BridgeError> {
        Self::new(Dtype::U8, shape, data)
    }

    /// Type of the elements.
    pub fn dtype(&self) -> Dtype {
        self.dtype
    }

    /// Size of each dimension, the slowest first.
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
            Dtype::I32 => each(&self.data, |bytes| f64::from(i32::from_le_bytes(bytes))),
            Dtype::I64 => each(&self.data, |bytes| i64::from_le_bytes(bytes) as f64),
            Dtype::F16 => each(&self.data, |bytes| half(u16::from_le_bytes(bytes))),
            Dtype::F32 => each(&self.data, |bytes| f64::from(f32::from_le_bytes(bytes))),
            Dtype::F64 => each(&self.data, f64::from_le_bytes),
        }
    }

    /// Encodes for GR00T: a map with a complete `.npy` file.
    pub fn to_gr00t(&self) -> Value {
        map([("__ndarray_class__", Value::from(true)), ("as_npy", Value::Binary(self.to_npy()))])
    }

    /// Decodes GR00T's form; `None` if the value is not an array.
    ///
    /// # Errors
    /// [`BridgeError::Malformed`]: the map or the file in it is damaged.
    pub fn of_gr00t(value: &Value) -> Option<Result<Self, BridgeError>> {
        entry(value, "__ndarray_class__")?;
        Some(match entry(value, "as_npy") {
            Some(Value::Binary(bytes)) => Self::of_npy(bytes),
            _ => Err(BridgeError::malformed("an array", "it has no bytes 'as_npy'")),
        })
    }

    /// Encodes for openpi: a map with byte keys.
    pub fn to_openpi(&self) -> Value {
        let shape = self.shape.iter().map(|&side| Value::from(side as u64)).collect();
        let entries: [(&[u8], Value); 4] = [
            (b"__ndarray__", Value::from(true)),
            (b"data", Value::Binary(self.data.clone())),
            (b"dtype", text(self.dtype.name())),
            (b"shape", Value::Array(shape)),
        ];
        Value::Map(entries.into_iter().map(|(key, value)| (Value::Binary(key.to_vec()), value)).collect())
    }

    /// Decodes openpi's form of an array or of a single number; `None` if the value is neither.
    ///
    /// # Errors
    /// [`BridgeError::Malformed`]: the map is damaged, or its type is unknown.
    pub fn of_openpi(value: &Value) -> Option<Result<Self, BridgeError>> {
        if entry(value, "__npgeneric__").is_some() {
            let number = entry(value, "data").and_then(Value::as_f64);
            let number = number.ok_or_else(|| BridgeError::malformed("a number", "its 'data' is not a number"));
            return Some(number.and_then(|number| Self::new(Dtype::F64, vec![], number.to_le_bytes().into())));
        }
        entry(value, "__ndarray__")?;
        let read = || {
            let wrong = |problem: &str| BridgeError::malformed("an array", problem);
            let dtype = entry(value, "dtype").and_then(as_text).ok_or_else(|| wrong("it has no 'dtype'"))?;
            let dtype = known(dtype)?;
            let shape = entry(value, "shape").and_then(Value::as_array).ok_or_else(|| wrong("it has no 'shape'"))?;
            let sides = shape.iter().map(|side| side.as_u64().and_then(|side| usize::try_from(side).ok()));
            let shape =
                sides.collect::<Option<Vec<_>>>().ok_or_else(|| wrong("its 'shape' is not of whole numbers"))?;
            match entry(value, "data") {
                Some(Value::Binary(data)) => Self::new(dtype, shape, data.clone()),
                _ => Err(wrong("it has no bytes 'data'")),
            }
        };
        Some(read())
    }
}

/// Finds an element type by NumPy's name, or fails with a list of those that are supported.
fn known(name: &str) -> Result<Dtype, BridgeError> {
    let known = || Dtype::ALL.map(|(_, name, _)| name).join(", ");
    Dtype::by_name(name).ok_or_else(|| {
        let name: String = name.chars().take(40).collect();
        BridgeError::malformed("an array", format!("its elements are '{name}'; use one of {}", known()))
    })
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
