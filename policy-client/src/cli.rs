//! The commands.

pub mod evaluate;
pub mod inspect;
pub mod list;
pub mod plan;
pub mod probe;
mod report;
pub mod run;

use fiatlux_policy::policies::{VlaArgs, VlaSource};
use fiatlux_policy::{Policy, PolicyError, policies};

/// The policy that a flag names.
fn policy(name: &str) -> Result<Box<dyn Policy>, Failure> {
    policies::by_name(name).map_err(usage)
}

/// A model server, for the policy `vla`: its contract is checked here, before anything moves.
fn model_server(name: &str, args: &VlaArgs, is_real_time: bool) -> Result<Option<VlaSource>, Failure> {
    match (name, &args.model) {
        ("vla", _) => args.checked(is_real_time).map(Some).map_err(usage),
        (_, None) => Ok(None),
        (other, Some(_)) => Err(Failure::Usage(format!("--model is of the policy vla, not of {other}"))),
    }
}

/// What a policy that cannot be made is to the command line.
fn usage(error: PolicyError) -> Failure {
    match error {
        PolicyError::Unknown { .. } | PolicyError::Unfit { .. } => Failure::Usage(error.to_string()),
        other => other.into(),
    }
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
