//! Why a message cannot be read.

use thiserror::Error;

/// Fault of a message, by field.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum WireError {
    #[error("{field} is missing")]
    Missing { field: &'static str },
    #[error("{field} has {found} numbers instead of {expected}")]
    Length { field: &'static str, found: usize, expected: usize },
    /// A number is infinite or NaN: no world has such a state, and rules are not made for it.
    #[error("{field} has a number that is not finite")]
    NotFinite { field: &'static str },
    #[error("{field} {problem}")]
    Value { field: &'static str, problem: String },
}

pub(crate) fn check_finite(field: &'static str, numbers: &[f64]) -> Result<(), WireError> {
    // Looks at every number, which is faster than to stop at the first: nearly always all are finite.
    let finite = numbers.iter().fold(true, |finite, number| finite & number.is_finite());
    if finite { Ok(()) } else { Err(WireError::NotFinite { field }) }
}

pub(crate) fn array<const N: usize>(field: &'static str, numbers: &[f64]) -> Result<[f64; N], WireError> {
    check_finite(field, numbers)?;
    numbers.try_into().map_err(|_| WireError::Length { field, found: numbers.len(), expected: N })
}
