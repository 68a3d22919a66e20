//! The commands.

pub mod inspect;
pub mod list;
mod plan;
mod report;
pub mod run;

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
