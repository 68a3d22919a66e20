//! Why a session cannot go on.

use thiserror::Error;

use crate::command::CommandError;

/// Why a session cannot go on.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum SessionFailure {
    /// The server does not start the episode.
    #[error("the server does not start episode {episode}: {message}")]
    Reset {
        /// Index of the episode.
        episode: u64,
        /// What the server says about it.
        message: String,
    },
    /// A command that no server takes; it was not sent.
    #[error("the policy commands {field} {problem} in step {step}; correct the policy")]
    Command {
        /// Which of the two lists: `action` or `joint_target`.
        field: &'static str,
        /// What is wrong with it.
        problem: String,
        /// Step of the observation that it answers.
        step: u64,
    },
    /// The server refuses an action.
    #[error("the server refuses the action of step {step}: {message} (field '{field}'); {remedy}")]
    Action {
        /// Step of the observation that the action answers.
        step: u64,
        /// Field of the action; may be empty.
        field: String,
        /// What the server says about it.
        message: String,
        /// What to do about it, as the server advises.
        remedy: String,
    },
    /// The session is not there any more.
    #[error("{message}; {remedy}")]
    Lost {
        /// What the server, or this client, says about it.
        message: String,
        /// What to do about it.
        remedy: String,
    },
    /// Messages of the server cannot be read.
    #[error("the server's {what} cannot be read: {reason}; use server and client of the same version")]
    Unreadable {
        /// Kind of the message.
        what: &'static str,
        /// What is wrong with it.
        reason: String,
    },
    /// The server is ahead in lockstep.
    #[error(
        "observation {expected} was expected and {found} came: someone else sends actions to this session; \
         open a new session"
    )]
    Order {
        /// Step that was expected.
        expected: u64,
        /// Step of the observation that came.
        found: u64,
    },
    /// The server does not answer.
    #[error(
        "server {server} has not answered {waited_for} within {silence_s} s, after {tries} tries{problem}; check that it \
         runs and can be reached (`policy-client list`), then start again"
    )]
    Silent {
        /// Name of the server.
        server: String,
        /// What should have been answered.
        waited_for: String,
        /// How long nothing came, s.
        silence_s: f64,
        /// How often it was sent.
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
            CommandError::Chunk { problem } => format!("whose chunk {problem}"),
            CommandError::NotFinite { value, joint, .. } => format!("{value} for joint {joint}"),
            CommandError::Range { value, joint, low, high, .. } => {
                format!("{value:?} for joint {joint}, not from {low} to {high},")
            }
        };
        Self::Command { field: error.field(), problem, step }
    }
}
