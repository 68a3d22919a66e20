//! One attempt at an episode of a run, in one session.

use std::fs::File;
use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::{SystemTime, UNIX_EPOCH};

use fiatlux_bag::run::{Event, LedgerError, Marks, NOT_REPEATED, Prefix, clip};
use fiatlux_cli::in_full;
use fiatlux_proto::ABORTED;
use fiatlux_proto::v3::refusal::Code;
use fiatlux_proto::v3::{EpisodeEnd, EpisodeResult, Refusal, RunTicket};
use fiatlux_rules::RowDigest;

use super::{AssignedEpisode, Run};
use crate::server::lock;

/// State of an attempt, updated by the simulation, the recorder and the end of the session.
pub(in crate::server) struct Attempt {
    run: Arc<Run>,
    episode: u32,
    number: u32,
    session: String,
    /// Rows of earlier attempts, which this one must repeat.
    prefix: Option<Prefix>,
    progress: Mutex<Progress>,
}

#[derive(Default)]
struct Progress {
    is_staged: bool,
    /// Step of the last row, and the digest of all rows so far.
    last: Option<(u64, RowDigest)>,
    /// Marks of the digests up to there.
    marks: Marks,
    /// It differs from an earlier attempt.
    differs: bool,
    /// Why it did not reach an end.
    cause: Option<String>,
    is_decided: bool,
}

impl AssignedEpisode {
    /// Begins an episode in a session; the line is on disk when this returns.
    pub fn begin(&self, session: &str, ticket: &RunTicket) -> Result<Arc<Attempt>, Refusal> {
        let Self { run, episode, prefix } = self;
        let number = ticket.attempt;
        let mut state = lock(&run.state);
        let opened = Event::Opened { episode: *episode, attempt: number, session: session.into(), unix_ms: unix_ms() };
        state.writer.append(opened).map_err(|error| not_written(&error))?;
        // If two servers are asked at once, the one whose line comes later sees the other's.
        let index = *episode as usize;
        let planned = state.ledger().registration().episodes.get(index).cloned();
        let free = planned.map_or(Ok(None), |planned| state.siblings()?.prefix_of(index, &planned));
        if let Err(refusal) = free {
            state.pending.push_back(Event::Abandoned {
                episode: *episode,
                attempt: number,
                session: session.into(),
                steps: 0,
                digest: String::new(),
                marks: Marks::default(),
                cause: clip(&refusal.message),
            });
            state.flush()?;
            return Err(refusal);
        }
        let attempt = Arc::new(Attempt::new(Arc::clone(run), *episode, number, session, prefix.clone()));
        state.open.insert(*episode, Arc::clone(&attempt));
        Ok(attempt)
    }
}

impl Attempt {
    pub(super) fn new(run: Arc<Run>, episode: u32, number: u32, session: &str, prefix: Option<Prefix>) -> Self {
        Self { run, episode, number, session: session.into(), prefix, progress: Mutex::default() }
    }

    pub fn session(&self) -> &str {
        &self.session
    }

    /// Refuses all but one episode, and that one a second time.
    pub fn stage(&self, episode: u64) -> Result<(), Refusal> {
        if episode != 0 {
            let message = format!("a session of a run has only episode 0, not {episode}; open the run's next episode");
            return Err(Refusal::new(Code::Value, "episode", message));
        }
        if std::mem::replace(&mut lock(&self.progress).is_staged, true) {
            let message = "a session of a run has one episode, which is over; close it and open the run's next episode";
            return Err(Refusal::new(Code::Value, "episode", message));
        }
        Ok(())
    }

    /// Checks a row before it is shown to anybody.
    ///
    /// # Errors
    /// The row differs from that of an earlier attempt.
    pub fn row(&self, step: u64, digest: &RowDigest, is_last: bool) -> Result<(), Refusal> {
        let mut progress = lock(&self.progress);
        progress.last = Some((step, digest.clone()));
        progress.marks.push(step, &digest.bytes());
        let Some(prefix) = &self.prefix else { return Ok(()) };
        let differs = step == prefix.steps && !digest.hex().eq_ignore_ascii_case(&prefix.digest);
        if differs || !prefix.marks.agrees(step, &digest.bytes()) || is_last && step < prefix.steps {
            progress.differs = true;
            let message = format!(
                "attempt {} did not repeat the rows of an earlier one, which went to step {}: they differ at step {step} or \
                 before, and the episode counts as a failure",
                self.number, prefix.steps
            );
            return Err(Refusal::new(Code::Value, "action", message));
        }
        Ok(())
    }

    /// Notes that its bag is whole. Returns whether the session can continue: a bag that cannot be synced to disk is
    /// lost.
    pub fn bag_is_whole(&self, bag: &Path, result: &EpisodeResult) -> bool {
        let EpisodeEnd { cause, digest, success, steps, .. } = result.end.clone().unwrap_or_default();
        if cause == ABORTED {
            return true;
        }
        if let Err(error) = sync(bag) {
            self.bag_is_lost(&format!("cannot sync {} to disk: {error}", bag.display()));
            return false;
        }
        let name = bag.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        self.decide(|attempt, _| Event::Played {
            episode: attempt.episode,
            attempt: attempt.number,
            session: attempt.session.clone(),
            bag: name,
            digest,
            cause: clip(&cause),
            success,
            steps,
        });
        true
    }

    /// Notes that its session ends it here, for this reason.
    pub fn is_cut_short(&self, why: &str) {
        lock(&self.progress).cause.get_or_insert_with(|| clip(why));
    }

    /// Notes that its bag could not be written, for this reason.
    pub fn bag_is_lost(&self, reason: &str) {
        lock(&self.progress).cause = Some(clip(&format!("the recording is lost: {reason}")));
    }

    /// Notes that its session is over: an attempt without an end is abandoned.
    pub fn settle(&self) {
        self.decide(|attempt, progress| {
            if progress.differs {
                return Event::Failed { episode: attempt.episode, attempt: attempt.number, cause: NOT_REPEATED.into() };
            }
            let unsaid = match progress.last {
                None => "the session ended before the episode began",
                // Not even the end of the recording was reported.
                Some(_) => "the recording is lost: it was not completed in time",
            };
            let (steps, digest) =
                progress.last.as_ref().map_or((0, String::new()), |(step, digest)| (*step, digest.hex()));
            Event::Abandoned {
                episode: attempt.episode,
                attempt: attempt.number,
                session: attempt.session.clone(),
                steps,
                digest,
                marks: progress.marks.clone(),
                cause: progress.cause.clone().unwrap_or_else(|| unsaid.into()),
            }
        });
    }

    /// Records a decision; only the first one counts.
    fn decide(&self, event: impl FnOnce(&Self, &Progress) -> Event) {
        let mut progress = lock(&self.progress);
        if std::mem::replace(&mut progress.is_decided, true) {
            return;
        }
        let event = event(self, &progress);
        drop(progress);
        let which = self.run.label(self.episode);
        match &event {
            Event::Played { cause, steps, .. } => tracing::info!("played {which}: {cause} after {steps} steps"),
            Event::Abandoned { cause, steps, .. } => {
                tracing::info!("attempt {} at {which} was cut off after {steps} steps: {cause}", self.number);
            }
            Event::Failed { cause, .. } => tracing::info!("attempt {} at {which} has failed: {cause}", self.number),
            // No attempt ends by these.
            Event::Opened { .. } | Event::Restarted { .. } | Event::Finished { .. } | Event::Sealed { .. } => {}
        }
        self.run.end(self.episode, event);
    }
}

impl std::fmt::Debug for Attempt {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Attempt").field("episode", &self.episode).field("number", &self.number).finish_non_exhaustive()
    }
}

/// Syncs a file and its directory entry.
fn sync(path: &Path) -> std::io::Result<()> {
    File::open(path)?.sync_all()?;
    path.parent().map_or(Ok(()), |folder| File::open(folder)?.sync_all())
}

/// The log says why. The client stops, because nothing could be played that would count.
pub(super) fn not_written(error: &LedgerError) -> Refusal {
    tracing::error!(error = in_full(error), "cannot write the ledger of a run");
    let message = match error {
        LedgerError::Exists { .. } => {
            "the server's folder has a run of that name that it could not resume; see its log, or give the run another name"
        }
        _ => {
            "the server cannot write the run's journal; free some space on its disk, see its log, and continue the run"
        }
    };
    Refusal::new(Code::Busy, "journal", message)
}

/// Now, since 1970, ms.
pub(super) fn unix_ms() -> u64 {
    let since_epoch = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    u64::try_from(since_epoch.as_millis()).unwrap_or(u64::MAX)
}
