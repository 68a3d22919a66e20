//! The ledgers of other servers that record into the same folder, so that no episode is played twice.

use std::fs::{File, TryLockError};
use std::path::{Path, PathBuf};

use fiatlux_bag::run::{EpisodeState, Ledger, LedgerEpisode, PlannedEpisode, Prefix, journal_of, journals};
use fiatlux_cli::in_full;
use fiatlux_proto::v3::refusal::Code;
use fiatlux_proto::v3::{Refusal, RunSpec};

use super::register;

/// The ledgers of other servers in the folder of one run.
pub(super) struct Siblings {
    folder: PathBuf,
    ledgers: Vec<Ledger>,
}

impl Siblings {
    /// Reads the ledgers of the run in this folder, which need not exist.
    pub fn read(folder: &Path, server: &str) -> Result<Self, Refusal> {
        let own = journal_of(folder, server);
        let found = if folder.is_dir() { journals(folder) } else { Ok(Vec::new()) };
        let others = found.map(|found| found.into_iter().filter(|path| *path != own));
        let ledgers = others.and_then(|paths| paths.map(Ledger::read).collect()).map_err(|error| {
            tracing::error!(error = in_full(&error), "cannot read the journal of another server");
            let message =
                "the server's folder has a journal of another server of this run that cannot be read; see its log";
            Refusal::new(Code::Busy, "", message)
        })?;
        Ok(Self { folder: folder.into(), ledgers })
    }

    /// Checks that the other servers registered the same key and spec; returns their episodes, if there are any.
    pub fn episodes(
        &self,
        run: &str,
        key_sha256: &str,
        spec: &RunSpec,
    ) -> Result<Option<Vec<PlannedEpisode>>, Refusal> {
        let mut episodes = None;
        for ledger in &self.ledgers {
            let registration = ledger.registration();
            if !register::is_same(&registration.key_sha256, key_sha256) {
                let message = format!("run '{run}' has another key on server '{}'; use that one", registration.server);
                return Err(Refusal::new(Code::Value, "key", message));
            }
            register::check_same(run, &registration.spec, spec)?;
            episodes = Some(registration.episodes.clone());
        }
        Ok(episodes)
    }

    /// Refuses an episode that another server has begun or played; returns the rows that it has to repeat.
    pub fn prefix_of(&self, index: usize, planned: &PlannedEpisode) -> Result<Option<Prefix>, Refusal> {
        let refuse = |code, what: String| Err(Refusal::new(code, "open", what));
        let mut longest: Option<Prefix> = None;
        for ledger in &self.ledgers {
            let server = &ledger.registration().server;
            if ledger.is_finished() {
                return refuse(Code::Closed, format!("the run is finished on server '{server}'; register another one"));
            }
            let Some(episode) = episode_at(ledger, index, planned) else { continue };
            match &episode.state {
                EpisodeState::Played(_) => {
                    return refuse(
                        Code::Value,
                        format!("the episode was played on server '{server}'; open another one"),
                    );
                }
                EpisodeState::Failed { cause } => {
                    let what = format!("the episode has failed on server '{server}' ({cause}); open another one");
                    return refuse(Code::Value, what);
                }
                EpisodeState::Open { .. } if is_alive(&self.folder, server) => {
                    return refuse(
                        Code::Busy,
                        format!("the episode is open on server '{server}'; wait until it is closed"),
                    );
                }
                EpisodeState::Open { .. } | EpisodeState::Waiting => {}
            }
            let known = longest.as_ref().map(|prefix| prefix.steps);
            if let Some(prefix) =
                episode.prefix.as_ref().filter(|prefix| known.is_none_or(|steps| prefix.steps > steps))
            {
                longest = Some(prefix.clone());
            }
        }
        Ok(longest)
    }

    /// The state of an episode that another server has decided, with that server's name.
    pub fn decided(&self, index: usize, planned: &PlannedEpisode) -> Option<(&str, &EpisodeState)> {
        let states = || {
            self.ledgers.iter().filter_map(|ledger| {
                let episode = episode_at(ledger, index, planned)?;
                Some((ledger.registration().server.as_str(), &episode.state))
            })
        };
        let played = states().find(|(_, state)| matches!(state, EpisodeState::Played(_)));
        played.or_else(|| states().find(|(_, state)| matches!(state, EpisodeState::Failed { .. })))
    }

    /// True if no other server continues: each has finished the run, or is dead and begins nothing in a finished run.
    pub fn are_finished(&self) -> bool {
        let is_over = |ledger: &Ledger| ledger.is_finished() || !is_alive(&self.folder, &ledger.registration().server);
        self.ledgers.iter().all(is_over)
    }
}

/// The episode in another server's ledger. The same spec gives the same order, so the index is the same, unless the
/// servers drew their own seeds.
fn episode_at<'a>(ledger: &'a Ledger, index: usize, planned: &PlannedEpisode) -> Option<&'a LedgerEpisode> {
    ledger.registration().episodes.get(index).filter(|other| *other == planned)?;
    ledger.episodes().get(index)
}

/// True if the server of that name holds its lock. Open episodes of a dead server are free.
fn is_alive(run_folder: &Path, server: &str) -> bool {
    let Some(folder) = run_folder.parent() else { return false };
    let Ok(file) = File::open(lock_of(folder, server)) else { return false };
    matches!(file.try_lock_shared(), Err(TryLockError::WouldBlock))
}

/// The lock that a server holds while it records into the folder.
pub(super) fn lock_of(folder: &Path, server: &str) -> PathBuf {
    folder.join(format!("{server}.lock"))
}
