//! Runs a recorded episode again on a server, and compares.

use std::path::Path;
use std::sync::atomic::AtomicBool;

use fiatlux_link::{LinkArgs, LinkError, Role};
use fiatlux_policy::policies::Replay;
use fiatlux_policy::{Client, ClientError, PolicyError};
use fiatlux_proto::v1::OpenRequest;
use thiserror::Error;
use tracing::warn;

use crate::{GradeOptions, bag};

/// Why an episode could not be verified. That it differs is no error but an answer.
#[derive(Debug, Error)]
pub enum VerifyError {
    /// The bag alone says enough.
    #[error("{bag} cannot be verified: {reason}")]
    Bag {
        /// The bag.
        bag: String,
        /// What is wrong with it.
        reason: String,
    },
    /// Its actions cannot be read.
    #[error("the bag's actions cannot be read")]
    Actions(#[from] PolicyError),
    /// No way to a server.
    #[error("there is no way to a server")]
    Link(#[from] LinkError),
    /// The server refuses, or is lost.
    #[error("the episode could not be run again")]
    Client(#[from] ClientError),
}

/// What a second run says of a bag.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Verification {
    /// Digest of the recorded rows, hexadecimal.
    pub recorded: String,
    /// Digest of the rows of the second run, hexadecimal.
    pub simulated: String,
    /// Steps and cause of the recorded episode's end.
    pub recorded_end: (u64, String),
    /// Steps and cause of the second run's end.
    pub simulated_end: (u64, String),
}

impl Verification {
    /// Whether all numbers of all rows are equal to the last bit.
    pub fn is_equal(&self) -> bool {
        self.recorded.eq_ignore_ascii_case(&self.simulated)
    }
}

/// Opens a session with a bag's conditions, sends its actions once more and compares the digests of the rows.
/// `progress` is told steps done and steps in all; a `stop` that becomes true ends it.
///
/// # Errors
/// [`VerifyError`]: a bag that is cut, aborted or altered; no server, or one that refuses.
pub fn verify(
    path: &Path,
    link: &LinkArgs,
    server: Option<&str>,
    progress: &mut dyn FnMut(u64, u64),
    stop: &AtomicBool,
) -> Result<Verification, VerifyError> {
    let wrong = |reason: String| VerifyError::Bag { bag: path.display().to_string(), reason };
    let content = bag::read(path, &GradeOptions::default()).map_err(|(_, reason)| wrong(reason))?;
    if let Some(reason) = content.cut.or_else(|| content.graded.flaw.as_ref().map(ToString::to_string)) {
        return Err(wrong(reason));
    }
    let steps = content.graded.summary.steps;
    let mut replay = Replay::open(path)?;
    let session = link.open(Role::Client)?;
    // Sensors change no row, and some take long.
    let request = OpenRequest { sensors: vec!["last_action".into()], weights: String::new(), ..replay.request() };
    let mut client = Client::open(&session, server, request)?;
    let end = client.run_episode(content.header.episode, &mut replay, &mut |step| progress(step, steps), stop)?;
    if let Err(error) = client.close() {
        // The answer is there; the server ends the session by itself.
        warn!("the session could not be closed: {error}");
    }
    Ok(Verification {
        recorded: content.graded.digest,
        simulated: end.digest,
        recorded_end: (steps, content.graded.end),
        simulated_end: (end.steps, end.cause),
    })
}
