//! Runs a recorded episode again on a server, and compares.

use std::fmt;
use std::path::Path;
use std::sync::atomic::AtomicBool;

use fiatlux_link::{LinkArgs, LinkError, Role};
use fiatlux_policy::policies::Replay;
use fiatlux_policy::{Client, ClientError, PolicyError};
use fiatlux_proto::v3::{EpisodeEnd, OpenRequest};
use fiatlux_wire::end_message;
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
#[derive(Debug, Clone, PartialEq)]
pub struct Verification {
    /// The recorded rows, as they are graded by what the bag says of the scene.
    pub recorded: EpisodeEnd,
    /// The second run, as the server judges it.
    pub simulated: EpisodeEnd,
}

impl Verification {
    /// Whether all numbers of all rows are equal to the last bit, and what they are judged to be.
    pub fn is_equal(&self) -> bool {
        let digest = &self.recorded.digest;
        let same_rows = digest.eq_ignore_ascii_case(&self.simulated.digest);
        same_rows && self.recorded == EpisodeEnd { digest: digest.clone(), ..self.simulated.clone() }
    }
}

impl fmt::Display for Verification {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.is_equal() {
            return writeln!(f, "equal: {}", in_words(&self.recorded));
        }
        writeln!(
            f,
            "different\n  recorded   {}\n  simulated  {}",
            in_words(&self.recorded),
            in_words(&self.simulated)
        )?;
        let remedy = "compare the server's version and model digest with the bag's header";
        writeln!(f, "The same build gives the same bytes: {remedy}.")
    }
}

fn in_words(end: &EpisodeEnd) -> String {
    let EpisodeEnd { digest, steps, cause, gate_progress, .. } = end;
    let flags = [("success", end.success), ("broken", end.broken), ("dropped", end.dropped)];
    let flags: String = flags.into_iter().filter(|(_, is)| *is).map(|(what, _)| format!(", {what}")).collect();
    format!("{steps} steps, {cause}, progress {gate_progress:.2}{flags}, digest {digest}")
}

/// Opens a session with a bag's conditions, sends its actions once more and compares the digests of the rows
/// and what they are judged to be.
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
    if let Some(reason) =
        content.damage.map(|(_, why)| why).or_else(|| content.graded.flaw.as_ref().map(ToString::to_string))
    {
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
    let graded = content.graded;
    Ok(Verification {
        recorded: end_message(&graded.summary, &graded.end, graded.causes, graded.digest),
        simulated: end,
    })
}
