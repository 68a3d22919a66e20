//! Why a session cannot go on.

use thiserror::Error;

use crate::command::CommandError;

/// Why a session cannot go on.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum SessionFailure {
    /// The server refuses to start the episode.
    #[error("the server refuses to start episode {episode}: {message}")]
    Reset {
        episode: u64,
        /// The server's reason, in its own words.
        message: String,
    },
    /// The policy's command is not valid; it was not sent.
    #[error("the policy commands {field} {problem} in step {step}; correct the policy")]
    Command {
        /// The field of the action with the error, such as `joint_target`.
        field: &'static str,
        problem: String,
        /// Step of the observation that the command answers.
        step: u64,
    },
    /// The server refuses an action; the policy should follow the remedy.
    #[error("the server refuses the action of step {step}: {message} (field '{field}'); {remedy}")]
    Action {
        /// Step of the observation that the action answers.
        step: u64,
        /// Field of the action; may be empty.
        field: String,
        /// The server's reason, in its own words.
        message: String,
        /// Remedy, as the server advises.
        remedy: String,
    },
    /// The session no longer exists.
    #[error("{message}; {remedy}")]
    Lost {
        /// The reason, from the server or from this client.
        message: String,
        remedy: String,
    },
    /// Several messages of the server could not be read.
    #[error("the server's {what} cannot be read: {reason}; use server and client of the same version")]
    Unreadable {
        /// Kind of the message, such as `observation`.
        what: &'static str,
        reason: String,
    },
    /// In lockstep, the server is ahead of this client, so somebody else must have sent actions.
    #[error(
        "expected observation {expected}, but received {found}: someone else sends actions to this session; \
         open a new session"
    )]
    Order { expected: u64, found: u64 },
    /// The server did not answer in time.
    #[error(
        "server {server} has not answered {waited_for} within {silence_s} s, after {tries} tries{problem}; check that it \
         runs and can be reached (`policy-client list`), then start again"
    )]
    Silent {
        server: String,
        waited_for: String,
        /// Time for which the server was silent, s.
        silence_s: f64,
        tries: u32,
        /// The last thing that went wrong; may be empty.
        problem: String,
    },
}

impl SessionFailure {
    pub(super) fn command(step: u64, error: &CommandError) -> Self {
        let problem = match error {
            CommandError::Form { .. } => "without a number".into(),
            CommandError::Length { found, expected, .. } => format!("of {found} numbers, not {expected},"),
            CommandError::Mixed => "with an action in action units".into(),
            CommandError::NoController => "in a session without a controller".into(),
            CommandError::WholeBody { value, low, high, .. } => format!("{value}, not from {low} to {high},"),
            CommandError::Chunk { problem } => format!("whose chunk {problem}"),
            CommandError::NotFinite { value, joint, .. } => format!("{value} for joint {joint}"),
            CommandError::Range { value, joint, low, high, .. } => {
                format!("{value:?} for joint {joint}, not from {low} to {high},")
            }
        };
        Self::Command { field: error.field(), problem, step }
    }
}
