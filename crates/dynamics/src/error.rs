use thiserror::Error;

/// Why a model, a state or a command was refused. Each message names the part and the field at fault.
#[derive(Debug, Clone, PartialEq, Error)]
#[allow(missing_docs)] // The messages say it.
pub enum ModelError {
    #[error("{part} '{name}': {field} is {value}, {rule}")]
    Value { part: &'static str, name: String, field: &'static str, value: f64, rule: &'static str },
    #[error("{part} '{name}': {reason}")]
    Structure { part: &'static str, name: String, reason: String },
    #[error("{what} has {found} numbers, this model needs {expected}")]
    Length { what: &'static str, expected: usize, found: usize },
    #[error("{what}[{index}] is {value}; every entry must be finite")]
    NotFinite { what: &'static str, index: usize, value: f64 },
}

/// Refuses an array of the wrong length or with an entry that is not finite.
///
/// # Errors
/// [`ModelError::Length`] or [`ModelError::NotFinite`].
pub fn check_array(what: &'static str, values: &[f64], expected: usize) -> Result<(), ModelError> {
    if values.len() != expected {
        return Err(ModelError::Length { what, expected, found: values.len() });
    }
    match values.iter().position(|v| !v.is_finite()) {
        Some(index) => Err(ModelError::NotFinite { what, index, value: values[index] }),
        None => Ok(()),
    }
}
