//! Why a session cannot go on.

use fiatlux_proto::v3::Notice;
use thiserror::Error;

use super::{ClientSession, MAX_REFUSALS, Output, Phase};
use crate::command::CommandError;

/// Why a session cannot go on.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum SessionFailure {
    #[error("the server refuses to start episode {episode}: {message}")]
    Reset { episode: u64, message: String },
    #[error("the policy commands {field} {problem} in step {step}; correct the policy")]
    Command { field: &'static str, problem: String, step: u64 },
    #[error("the server refuses the action of step {step}: {message} (field '{field}'); {remedy}")]
    Action { step: u64, field: String, message: String, remedy: String },
    #[error("{message}; {remedy}")]
    Lost { message: String, remedy: String },
    #[error("the server's {what} cannot be read: {reason}; use server and client of the same version")]
    Unreadable { what: &'static str, reason: String },
    #[error(
        "expected observation {expected}, but received {found}: someone else sends actions to this session; \
         open a new session"
    )]
    Order { expected: u64, found: u64 },
    #[error(
        "server {server} has not answered {waited_for} within {silence_s} s, after {tries} tries{problem}; check that it \
         runs and can be reached (`policy-client list`), then start again"
    )]
    Silent { server: String, waited_for: String, silence_s: f64, tries: u32, problem: String },
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

impl ClientSession {
    /// The server refused an action; the notice has the server's present step. A single refusal may be for an old copy, or for
    /// something that someone else sent. Only repeated refusals of the same action are ours.
    pub(super) fn refused(&mut self, notice: Notice) {
        let Phase::Waiting { step, .. } = self.phase else { return };
        if notice.episode != self.episode {
            return;
        }
        self.refusals += 1;
        self.problem = Some(notice.message.clone());
        if self.refusals >= MAX_REFUSALS {
            let Notice { field, message, remedy, .. } = notice;
            self.fail(SessionFailure::Action { step, field, message, remedy });
        }
    }

    pub(super) fn unreadable(&mut self, what: &'static str, reason: String) {
        self.refusals += 1;
        self.problem = Some(format!("a message could not be read: {reason}"));
        if self.refusals >= MAX_REFUSALS && !matches!(self.phase, Phase::Idle) {
            self.fail(SessionFailure::Unreadable { what, reason });
        }
    }

    pub(super) fn silent(&self) -> SessionFailure {
        let waited_for = match &self.phase {
            Phase::Waiting { step, .. } => format!("action {step} of episode {}", self.episode),
            _ => format!("the reset to episode {}", self.episode),
        };
        SessionFailure::Silent {
            server: self.info.server.clone(),
            waited_for,
            silence_s: self.silence.as_secs_f64(),
            tries: self.tries + 1,
            problem: self.problem.as_ref().map_or_else(String::new, |problem| format!("; last: {problem}")),
        }
    }

    pub(super) fn fail(&mut self, failure: SessionFailure) {
        self.phase = Phase::Idle;
        self.outputs.push_back(Output::Failed(failure));
    }
}
