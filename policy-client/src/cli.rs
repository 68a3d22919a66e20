//! The commands.

pub mod evaluate;
pub mod inspect;
pub mod list;
pub mod plan;
mod report;
pub mod run;

use fiatlux_policy::{Policy, PolicyError, policies};

/// The policy that a flag names.
fn policy(name: &str) -> Result<Box<dyn Policy>, Failure> {
    policies::by_name(name).map_err(|error| match error {
        PolicyError::Unknown { .. } => Failure::Usage(error.to_string()),
        other => other.into(),
    })
}

/// Why a command has not done its work.
pub enum Failure {
    /// It was asked for wrongly.
    Usage(String),
    /// It could not be done.
    Failed(anyhow::Error),
}

impl<E: Into<anyhow::Error>> From<E> for Failure {
    fn from(error: E) -> Self {
        Self::Failed(error.into())
    }
}
