//! The subcommands of the program.

pub mod deploy;
pub mod evaluate;
pub mod inspect;
pub mod list;
pub mod plan;
pub mod probe;
mod report;
pub mod run;
pub mod teleop;

use fiatlux_client::{Policy, PolicyError};
use fiatlux_policies::{Policies, VlaArgs, VlaSource};

/// Makes the policy that a flag names.
fn policy(name: &str) -> Result<Box<dyn Policy>, Failure> {
    Policies::default().make(name).map_err(usage)
}

/// Opens the model server of the policy `vla` for a robot, and checks its contract before anything moves.
fn model_server(name: &str, args: &VlaArgs, robot: &str, is_real_time: bool) -> Result<Option<VlaSource>, Failure> {
    match (name, &args.model) {
        ("vla", _) => args.checked(robot, is_real_time).map(Some).map_err(usage),
        (_, None) => Ok(None),
        (other, Some(_)) => Err(Failure::Usage(format!("--model belongs to the policy vla, not to {other}"))),
    }
}

/// Sorts an error of a policy: a wrong flag is a usage error, anything else a failure.
fn usage(error: PolicyError) -> Failure {
    match error {
        PolicyError::Unknown { .. } | PolicyError::Unfit { .. } | PolicyError::Tasks { .. } => {
            Failure::Usage(error.to_string())
        }
        other => other.into(),
    }
}

/// Why a command failed, which decides the exit code.
pub enum Failure {
    /// The command line is wrong.
    Usage(String),
    /// The work could not be done.
    Failed(anyhow::Error),
}

impl<E: Into<anyhow::Error>> From<E> for Failure {
    fn from(error: E) -> Self {
        Self::Failed(error.into())
    }
}
