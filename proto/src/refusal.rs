//! Refusals, as servers make them.

use crate::DecodeError;
use crate::v3::Refusal;
use crate::v3::refusal::Code;

impl Refusal {
    /// A refusal of a request's field, which may be empty; the message says what is wrong and what to do.
    pub fn new(code: Code, field: &str, message: impl Into<String>) -> Self {
        Self { code: code.into(), message: message.into(), field: field.into() }
    }
}

/// Of a request that cannot be read.
impl From<&DecodeError> for Refusal {
    fn from(error: &DecodeError) -> Self {
        Self::new(Code::Malformed, "", error.to_string())
    }
}
