//! Plays one episode in its own thread.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Instant;

use fiatlux_proto::v3::EpisodeEnd;
use fiatlux_proto::v3::refusal::Code;

use super::{Calls, MakePolicy, Setback};
use crate::{Client, ClientError};

/// An episode that is being played.
#[derive(Debug, Clone)]
pub(super) struct Job {
    pub server: String,
    pub since: Instant,
    pub broken_off: Arc<AtomicBool>,
    /// The step that it has reached.
    pub step: Arc<AtomicU64>,
}

impl Job {
    /// Asks its thread to end.
    pub(super) fn break_off(&self) {
        self.broken_off.store(true, Ordering::Relaxed);
    }

    /// Plays the episode to its end. `opened` is called when its session is open.
    pub(super) fn play(
        &self,
        calls: Calls<'_>,
        index: usize,
        make_policy: &MakePolicy<'_>,
        stop: &AtomicBool,
        opened: &dyn Fn(),
    ) -> Result<EpisodeEnd, ClientError> {
        // The session does not wait for a policy that is slow to load.
        let mut policy = make_policy()?;
        if self.broken_off.load(Ordering::Relaxed) {
            return Err(ClientError::Stopped);
        }
        let (info, secrets) = calls.open(&self.server, index)?;
        opened();
        let mut client = Client::enter(calls.link, &self.server, info, &secrets)?;
        let mut note = |step| self.step.store(step, Ordering::Relaxed);
        let end = client.run_episode(0, policy.as_mut(), &mut note, &self.broken_off);
        // Closing would only wait for a server that is gone.
        let is_lost = matches!(end, Err(ClientError::Stopped)) && !stop.load(Ordering::Relaxed);
        if !is_lost && let Err(error) = client.close() {
            tracing::debug!("episode {index}: the session was not closed: {error}");
        }
        end
    }
}

/// What an error means for the episode.
pub(super) fn setback(error: &ClientError) -> Setback {
    match error {
        ClientError::Stopped => Setback::BrokenOff,
        ClientError::Refused { code: Code::Busy, field, .. } if field == "open" => Setback::Held,
        ClientError::Refused { code: Code::Busy, .. } => Setback::Busy,
        ClientError::Refused { .. } => Setback::Refused(error.to_string()),
        // A deterministic policy would fail again.
        ClientError::Policy(_) => Setback::Hopeless(error.to_string()),
        _ => Setback::Failed(error.to_string()),
    }
}
