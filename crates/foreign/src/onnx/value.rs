//! Values at load: their shapes, and their numbers if they are known already.

use std::rc::Rc;

use super::Refusal;
use super::file::Tensor;

/// Maximum number of numbers of a value, and of all that operators make at load.
pub(super) const MAX_NUMBERS: usize = 1 << 26;
const MAX_RANK: usize = 8;

/// Names of the types of tensors, in the order of their codes.
const KINDS: &str = "undefined f32 u8 i8 u16 i16 i32 i64 string bool f16 f64 u32 u64 complex64 complex128 bf16";
pub(super) const F32: i64 = 1;
pub(super) const I32: i64 = 6;
pub(super) const I64: i64 = 7;
const F64: i64 = 11;

#[derive(Debug, Clone)]
pub(super) enum Data {
    /// Constants.
    Floats(Rc<[f32]>),
    /// Constants: a shape, axes or indices.
    Integers(Rc<[i64]>),
    /// Computed in each run: index in the arena of the first number.
    Computed(usize),
}

#[derive(Debug, Clone)]
pub(super) struct Value {
    pub shape: Vec<usize>,
    pub data: Data,
}

impl Value {
    pub fn list(numbers: impl Iterator<Item = i64>) -> Self {
        let numbers: Rc<[i64]> = numbers.collect();
        Self { shape: vec![numbers.len()], data: Data::Integers(numbers) }
    }

    /// One number without dimensions.
    pub fn scalar(number: f32) -> Self {
        Self { shape: vec![], data: Data::Floats([number].into()) }
    }

    /// The numbers of a tensor in the file, called `name` in errors. f64 becomes f32.
    pub fn of_tensor(tensor: &Tensor<'_>, name: &str) -> Result<Self, Refusal> {
        if tensor.is_external {
            return Err(format!("its tensor '{name}' is stored in another file").into());
        }
        let data = match tensor.kind {
            F32 if tensor.raw.is_empty() => Data::Floats(tensor.floats.as_slice().into()),
            F32 => Data::Floats(numbers(tensor.raw, f32::from_le_bytes)),
            F64 => Data::Floats(numbers(tensor.raw, |bytes| f64::from_le_bytes(bytes) as f32)),
            I32 | I64 if tensor.raw.is_empty() => Data::Integers(tensor.integers.as_slice().into()),
            I32 => Data::Integers(numbers(tensor.raw, |bytes| i32::from_le_bytes(bytes).into())),
            I64 => Data::Integers(numbers(tensor.raw, i64::from_le_bytes)),
            other => return Err(format!("its tensor '{name}' is of type {}, not f32 or i64", kind(other)).into()),
        };
        let sizes: Result<Vec<usize>, _> = tensor.shape.iter().map(|size| usize::try_from(*size)).collect();
        let value = Self { shape: sizes.unwrap_or_default(), data };
        let found = value.floats().map_or(0, <[f32]>::len) + value.integers().map_or(0, <[i64]>::len);
        // An empty list is the only value without numbers.
        if tensor.shape != [0] && count(&value.shape) != Ok(found) || tensor.shape.len() != value.shape.len() {
            return Err(format!("its tensor '{name}' has {found} numbers for the shape {:?}", tensor.shape).into());
        }
        match value.floats().and_then(|numbers| numbers.iter().position(|number| !number.is_finite())) {
            Some(index) => Err(Refusal::NotFinite { tensor: name.into(), index }),
            None => Ok(value),
        }
    }

    /// Numbers that are known at load.
    pub fn floats(&self) -> Option<&[f32]> {
        if let Data::Floats(numbers) = &self.data { Some(numbers) } else { None }
    }

    /// Integers, which are always known at load.
    pub fn integers(&self) -> Option<&[i64]> {
        if let Data::Integers(numbers) = &self.data { Some(numbers) } else { None }
    }
}

fn numbers<const SIZE: usize, T>(raw: &[u8], number: impl Fn([u8; SIZE]) -> T) -> Rc<[T]> {
    let (numbers, _) = raw.as_chunks();
    numbers.iter().map(|bytes| number(*bytes)).collect()
}

pub(super) fn kind(code: i64) -> String {
    let name = usize::try_from(code).ok().and_then(|code| KINDS.split(' ').nth(code));
    name.map_or_else(|| format!("number {code}"), String::from)
}

pub(super) fn count(shape: &[usize]) -> Result<usize, String> {
    let count = shape.iter().try_fold(1_usize, |count, size| count.checked_mul(*size));
    match count.filter(|count| (1..=MAX_NUMBERS).contains(count) && shape.len() <= MAX_RANK) {
        Some(count) => Ok(count),
        None => Err(format!("a value would have the shape {shape:?}; it needs 1 to {MAX_NUMBERS} numbers")),
    }
}

/// Distances of neighbours along each axis in the flat value.
pub(super) fn strides(shape: &[usize]) -> Vec<isize> {
    (0..shape.len()).map(|axis| shape[axis + 1..].iter().product::<usize>() as isize).collect()
}

/// For each number of a shape, its index in a flat value with these strides that begins at `start`.
pub(super) fn places(shape: &[usize], strides: &[isize], start: isize) -> impl Iterator<Item = usize> + use<> {
    let axes: Vec<_> = shape.iter().copied().zip(strides.iter().copied()).rev().collect();
    (0..shape.iter().product::<usize>()).map(move |flat| {
        let mut rest = flat;
        let along = |(size, stride): &(usize, isize)| {
            let coordinate = rest % size;
            rest /= size;
            coordinate as isize * stride
        };
        (start + axes.iter().map(along).sum::<isize>()) as usize
    })
}

/// The shape of two values that are matched axis by axis from the last one, where an axis of 1 fits any.
pub(super) fn broadcast(one: &[usize], other: &[usize]) -> Result<Vec<usize>, String> {
    let rank = one.len().max(other.len());
    let size = |shape: &[usize], axis: usize| (axis + shape.len()).checked_sub(rank).map_or(1, |axis| shape[axis]);
    let sizes = (0..rank).map(|axis| match (size(one, axis), size(other, axis)) {
        (one, other) if one == other || other == 1 => Some(one),
        (1, other) => Some(other),
        _ => None,
    });
    sizes.collect::<Option<_>>().ok_or_else(|| format!("the shapes {one:?} and {other:?} cannot be broadcast"))
}

/// An axis or index below `size`, which counts from the end if it is negative.
pub(super) fn index(number: i64, size: usize) -> Result<usize, String> {
    let counted = if number < 0 { number.saturating_add(size as i64) } else { number };
    let index = usize::try_from(counted).ok().filter(|index| *index < size);
    index.ok_or_else(|| format!("the axis or index {number} is outside of 0..{size}"))
}
