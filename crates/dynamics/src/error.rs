use thiserror::Error;

/// Why a model, a state or a command was refused. Each message names the part and the field at fault.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum ModelError {
    /// A number is outside what physics or the solver allows.
    #[error("{part} '{name}': {field} is {value}, {rule}")]
    Value {
        /// Kind of the part, such as `body`.
        part: &'static str,
        /// Name of the part.
        name: String,
        /// Name of the field at fault, such as `mass`.
        field: &'static str,
        /// The value that was given.
        value: f64,
        /// The rule it breaks, with the remedy.
        rule: &'static str,
    },
    /// A part's structure is wrong.
    #[error("{part} '{name}': {reason}")]
    Structure {
        /// Kind of the part.
        part: &'static str,
        /// Name of the part.
        name: String,
        /// Fault and remedy.
        reason: String,
    },
    /// An array has the wrong length.
    #[error("{what} has {found} numbers, this model needs {expected}")]
    Length {
        /// Name of the array, such as `qpos`.
        what: &'static str,
        /// Length the model needs.
        expected: usize,
        /// Length that was given.
        found: usize,
    },
    /// An entry of an array is NaN or infinite.
    #[error("{what}[{index}] is {value}; every entry must be finite")]
    NotFinite {
        /// Name of the array, such as `qpos`.
        what: &'static str,
        /// First entry at fault.
        index: usize,
        /// The value at that index.
        value: f64,
    },
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
