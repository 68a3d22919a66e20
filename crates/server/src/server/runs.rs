//! Runs: each is registered once, each of its episodes is played once, and ledgers on disk keep track
//! (`fiatlux_bag::run`).

mod attempt;
mod register;
mod shared;
mod siblings;
#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, VecDeque};
use std::fs::{self, File, TryLockError};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use fiatlux_access::{Identity, sign_journal};
use fiatlux_bag::run::{
    EpisodeState, Event, Ledger, LedgerError, LedgerWriter, MAX_ATTEMPTS, PlannedEpisode, Prefix, Registration,
    ends_finished, journal_of,
};
use fiatlux_cli::in_full;
use fiatlux_proto::keys::is_name;
use fiatlux_proto::v3::refusal::Code;
use fiatlux_proto::v3::run_episode::State as StateMessage;
use fiatlux_proto::v3::{Refusal, RunEpisode, RunInfo, RunSpec, RunTicket};
use thiserror::Error;

use super::info::VERSION;
use super::lock;
use super::plan::{self, Plan};
pub(super) use attempt::Attempt;
use attempt::{not_written, unix_ms};
pub use shared::SharedSeeds;
use siblings::{Siblings, lock_of};

/// Largest number of unfinished runs on a server, and of their episodes. Finished ones stay on disk alone.
const MAX_RUNS: usize = 1000;
const MAX_EPISODES_OF_ALL: usize = 200_000;

/// Finished runs that are kept in memory once somebody has asked for them.
const MAX_RECENT: usize = 64;

/// Longest cause that a client gets, characters: a reply contains many.
const MAX_CAUSE: usize = 100;

/// Number of attempts to lock the folder at the start, and the time between them.
const LOCK_TRIES: u32 = 5;
const LOCK_AGAIN: Duration = Duration::from_millis(50);

#[derive(Debug, Error)]
pub enum RecordError {
    #[error(
        "another server named '{server}' records into {folder}; stop it, or give this one another --name or --record"
    )]
    Taken { server: String, folder: PathBuf },
    #[error("cannot {action} {path}; check that it exists, its permissions, and the free space")]
    Io { action: &'static str, path: PathBuf, source: std::io::Error },
}

/// The runs of a server.
pub(super) struct Runs {
    folder: PathBuf,
    server: String,
    /// Those that are not finished, and some that have been since the last registration.
    runs: Mutex<BTreeMap<String, Arc<Run>>>,
    /// Finished ones that somebody has asked for, the latest last.
    recent: Mutex<VecDeque<(String, Arc<Run>)>>,
    /// Largest number of unfinished runs.
    most: usize,
    shared: Option<SharedSeeds>,
}

/// One run. Its lock is held while a line is written to disk.
pub(super) struct Run {
    state: Mutex<RunState>,
}

struct RunState {
    writer: LedgerWriter,
    /// Events that could not be written yet.
    pending: VecDeque<Event>,
    /// Attempts at the open episodes, by the episode's index.
    open: BTreeMap<u32, Arc<Attempt>>,
}

/// An episode that is about to begin.
pub(super) struct AssignedEpisode {
    run: Arc<Run>,
    episode: u32,
    /// Rows of earlier attempts that it must repeat.
    prefix: Option<Prefix>,
}

impl Runs {
    /// Loads the runs of the server of that name from a folder, which is created if necessary. The file is a lock that
    /// keeps other servers out.
    pub fn open(folder: &Path, server: &str, shared: Option<SharedSeeds>) -> Result<(Self, File), RecordError> {
        let failed = |action, path: &Path| {
            let path = path.to_owned();
            move |source| RecordError::Io { action, path, source }
        };
        fs::create_dir_all(folder).map_err(failed("make the folder", folder))?;
        let path = lock_of(folder, server);
        let file = File::options().create(true).append(true).open(&path).map_err(failed("open", &path))?;
        let mut tries = LOCK_TRIES;
        loop {
            tries -= 1;
            match file.try_lock() {
                Ok(()) => break,
                // Another server may be checking at this moment whether this one is alive.
                Err(TryLockError::WouldBlock) if tries > 0 => std::thread::sleep(LOCK_AGAIN),
                Err(TryLockError::WouldBlock) => {
                    return Err(RecordError::Taken { server: server.into(), folder: folder.into() });
                }
                Err(TryLockError::Error(error)) => return Err(failed("lock", &path)(error)),
            }
        }
        let (mut runs, mut finished) = (BTreeMap::new(), 0);
        for entry in fs::read_dir(folder).map_err(failed("read the folder", folder))? {
            let entry = entry.map_err(failed("read the folder", folder))?;
            let Some(name) = entry.file_name().to_str().filter(|name| is_name(name)).map(str::to_owned) else {
                continue;
            };
            let journal = journal_of(&entry.path(), server);
            if !journal.is_file() {
                continue;
            }
            if ends_finished(&journal).unwrap_or(false) {
                finished += 1;
                continue;
            }
            match Run::take_up(&journal, server, &name) {
                Ok(run) => {
                    runs.insert(name, Arc::new(run));
                }
                // The other runs continue; this one cannot be registered again while its journal exists.
                Err(error) => tracing::error!(run = name, error = in_full(&error), "cannot resume a run"),
            }
        }
        tracing::info!(folder = %folder.display(), runs = runs.len(), finished, "recording sessions to this folder");
        let (runs, recent) = (Mutex::new(runs), Mutex::default());
        Ok((Self { folder: folder.into(), server: server.into(), runs, recent, most: MAX_RUNS, shared }, file))
    }

    /// The run of that name, from memory or from disk.
    fn known(&self, name: &str) -> Option<Arc<Run>> {
        if let Some(run) = lock(&self.runs).get(name) {
            return Some(Arc::clone(run));
        }
        let mut recent = lock(&self.recent);
        if let Some((_, run)) = recent.iter().find(|(known, _)| known == name) {
            return Some(Arc::clone(run));
        }
        let journal = journal_of(&self.folder.join(name), &self.server);
        if !is_name(name) || !journal.is_file() {
            return None;
        }
        let run = match Run::take_up(&journal, &self.server, name) {
            Ok(run) => Arc::new(run),
            Err(error) => {
                tracing::error!(run = name, error = in_full(&error), "cannot resume a run");
                return None;
            }
        };
        if run.is_over() {
            if recent.len() >= MAX_RECENT {
                recent.pop_front();
            }
            recent.push_back((name.into(), Arc::clone(&run)));
        } else {
            lock(&self.runs).insert(name.into(), Arc::clone(&run));
        }
        Some(run)
    }

    /// Forgets finished runs: nothing more is written to them.
    fn retire(&self) {
        lock(&self.runs).retain(|_, run| {
            let state = lock(&run.state);
            let ledger = state.ledger();
            let is_idle = ledger.is_finished() && state.pending.is_empty() && state.open.is_empty();
            // A client that holds one without a signature may still have it signed.
            !(is_idle && (ledger.seal().is_some() || Arc::strong_count(run) == 1))
        });
    }

    /// The run of that name and key; `None` if there is no such run.
    fn get(&self, name: &str, key_sha256: &str) -> Result<Option<Arc<Run>>, Refusal> {
        let Some(run) = self.known(name) else { return Ok(None) };
        if !register::is_same(&lock(&run.state).writer.ledger().registration().key_sha256, key_sha256) {
            let message = format!(
                "the key is not the one of run '{name}'; use the key that it was registered with, or give the new run \
                 another name"
            );
            return Err(Refusal::new(Code::Value, "key", message));
        }
        Ok(Some(run))
    }

    /// The run of that name and key; a refusal if there is none.
    pub fn find(&self, name: &str, key: &str) -> Result<Arc<Run>, Refusal> {
        self.get(name, &register::key_digest(key))?.ok_or_else(|| {
            let message = format!("run '{name}' does not exist on this server; register it");
            Refusal::new(Code::Unknown, "run", message)
        })
    }

    /// Registers a run, for the `holder` of a token; empty without tokens.
    pub fn register(&self, name: &str, key: &str, spec: RunSpec, holder: &str) -> Result<Arc<Run>, Refusal> {
        let spec = register::with_all_seeds(spec)?;
        if !is_name(name) {
            let message = format!("'{name:.80}' cannot be a run's name; use 1 to 64 letters, digits, - or _");
            return Err(Refusal::new(Code::Value, "run", message));
        }
        let key_sha256 = register::key_digest(key);
        if let Some(run) = self.get(name, &key_sha256)? {
            register::check_same(name, &lock(&run.state).writer.ledger().registration().spec, &spec)?;
            return Ok(run);
        }
        let folder = self.folder.join(name);
        let shared = self.shared.as_ref().filter(|_| spec.hosted_seeds > 0);
        let drawn = Siblings::read(&folder, &self.server)?.episodes(name, &key_sha256, &spec)?;
        let seeds = shared.map(|shared| shared.seeds(name, &key_sha256, &spec));
        let episodes = drawn.map_or_else(|| register::episodes(&spec, seeds), Ok)?;
        self.retire();
        let known = lock(&self.runs).values().cloned().collect::<Vec<_>>();
        let all: usize = known.iter().map(|run| lock(&run.state).writer.ledger().episodes().len()).sum();
        if known.len() >= self.most || all + episodes.len() > MAX_EPISODES_OF_ALL {
            let message = format!(
                "the server has {} unfinished runs with {all} episodes and accepts {} with {MAX_EPISODES_OF_ALL}; finish \
                 some, use another server, or have its owner move abandoned ones out of its folder and start it again",
                known.len(),
                self.most
            );
            return Err(Refusal::new(Code::Busy, "", message));
        }
        let registration = Registration {
            protocol: fiatlux_proto::PROTOCOL,
            version: VERSION.into(),
            server: self.server.clone(),
            run: name.into(),
            key_sha256,
            spec,
            episodes,
            unix_ms: unix_ms(),
            holder: holder.into(),
            group: shared.map(|shared| shared.group.clone()).unwrap_or_default(),
        };
        let writer = LedgerWriter::create(&folder, registration).map_err(|error| match error {
            LedgerError::Event { reason, .. } => Refusal::new(Code::Value, "register", reason),
            error => not_written(&error),
        })?;
        let count = writer.ledger().episodes().len();
        tracing::info!(run = name, episodes = count, "registered a run");
        let run = Arc::new(Run::new(writer));
        lock(&self.runs).insert(name.into(), Arc::clone(&run));
        Ok(run)
    }

    /// The attempt that a bag belongs to; `None` if it has already ended.
    pub fn attempt_of(&self, ticket: &RunTicket, session: &str) -> Option<Arc<Attempt>> {
        let run = lock(&self.runs).get(&ticket.run).cloned()?;
        let attempt = lock(&run.state).open.get(&ticket.episode).cloned()?;
        (attempt.session() == session).then_some(attempt)
    }
}

impl Run {
    fn new(writer: LedgerWriter) -> Self {
        Self { state: Mutex::new(RunState { writer, pending: VecDeque::new(), open: BTreeMap::new() }) }
    }

    fn take_up(journal: &Path, server: &str, name: &str) -> Result<Self, LedgerError> {
        let mut writer = LedgerWriter::open(journal)?;
        let Registration { server: of_server, run, .. } = writer.ledger().registration();
        if of_server != server || run != name {
            let reason = format!("it belongs to run '{run}' on server '{of_server}', and is in the wrong folder");
            return Err(LedgerError::Line { path: journal.into(), line: 1, reason });
        }
        if writer.ledger().open().next().is_some() {
            writer.append(Event::Restarted { unix_ms: unix_ms() })?;
        }
        Ok(Self::new(writer))
    }

    fn is_over(&self) -> bool {
        lock(&self.state).ledger().is_finished()
    }

    /// The state of the run, for its client. Hosted seeds are included once it is finished.
    ///
    /// # Errors
    /// An event cannot be written to disk; the client must not hear of it then.
    pub fn info(&self) -> Result<RunInfo, Refusal> {
        let mut state = lock(&self.state);
        state.flush()?;
        let ledger = state.ledger();
        let is_waiting = ledger.episodes().iter().any(|episode| episode.state == EpisodeState::Waiting);
        let asks_siblings = is_waiting || ledger.is_hosted() && ledger.is_finished();
        let siblings = if asks_siblings { state.siblings().ok() } else { None };
        // On another server with the same seeds the run may continue.
        let is_over = || ledger.is_finished() && siblings.as_ref().is_some_and(Siblings::are_finished);
        let hides_seeds = ledger.is_hosted() && !is_over();
        let planned = &ledger.registration().episodes;
        let own_name = &ledger.registration().server;
        let episodes = planned.iter().zip(ledger.episodes()).enumerate().map(|(index, (planned, episode))| {
            let owner = ledger.registration().owner(index).filter(|owner| owner != own_name);
            let mut message = RunEpisode {
                task: planned.task.clone(),
                seed: if hides_seeds || owner.is_some() { 0 } else { planned.seed },
                attempts: episode.attempts,
                server: owner.unwrap_or_default().into(),
                ..RunEpisode::default()
            };
            if owner.is_some() {
                return message;
            }
            let own = (ledger.registration().server.as_str(), &episode.state);
            let elsewhere = || siblings.as_ref()?.decided(index, planned);
            let (server, state) = match own.1 {
                EpisodeState::Waiting => elsewhere().unwrap_or(own),
                _ => own,
            };
            match state {
                EpisodeState::Waiting => message.cause = episode.abandoned.chars().take(MAX_CAUSE).collect(),
                EpisodeState::Open { .. } => message.state = StateMessage::Open.into(),
                EpisodeState::Played(played) => {
                    message.state = StateMessage::Played.into();
                    message.cause.clone_from(&played.cause);
                    message.digest.clone_from(&played.digest);
                    message.success = played.success;
                    message.server = server.into();
                }
                EpisodeState::Failed { cause } => {
                    message.state = StateMessage::Failed.into();
                    message.cause.clone_from(cause);
                    message.server = server.into();
                }
            }
            message
        });
        let Registration { run, spec, .. } = ledger.registration();
        Ok(RunInfo {
            run: run.clone(),
            spec: Some(spec.clone()),
            episodes: episodes.collect(),
            finished: ledger.is_finished(),
            link: String::new(),
        })
    }

    /// An episode for the log, such as `S05 seed 0 of run walk-71948c02`.
    fn label(&self, index: u32) -> String {
        let state = lock(&self.state);
        let Registration { run, episodes, .. } = state.ledger().registration();
        match episodes.get(index as usize) {
            Some(PlannedEpisode { task, seed }) => format!("{task} seed {seed} of run {run}"),
            None => format!("episode {index} of run {run}"),
        }
    }

    /// The session in which to play an episode, if it may be played.
    pub fn plan(self: &Arc<Self>, index: u32) -> Result<(Plan, AssignedEpisode), Refusal> {
        let mut state = lock(&self.state);
        state.flush()?;
        let ledger = state.writer.ledger();
        let Registration { run, version, spec, episodes, .. } = ledger.registration();
        let wrong = |code, message: String| Err(Refusal::new(code, "open", message));
        if version != VERSION {
            let message = format!(
                "the run was registered with version {version} of the server, but this is {VERSION}; start that one, or finish \
                 the run"
            );
            return wrong(Code::Version, message);
        }
        if ledger.is_finished() {
            return wrong(Code::Closed, "the run is finished; register another one".into());
        }
        let found = episodes.get(index as usize).zip(ledger.episodes().get(index as usize));
        let Some((planned, episode)) = found else {
            return wrong(
                Code::Value,
                format!("episode {index} does not exist; the run has {}, from 0 on", episodes.len()),
            );
        };
        let Registration { server, .. } = ledger.registration();
        if let Some(owner) = ledger.registration().owner(index as usize).filter(|owner| owner != server) {
            return wrong(Code::Value, format!("episode {index} belongs to server '{owner}'; open it there"));
        }
        match &episode.state {
            EpisodeState::Open { session } => {
                let message =
                    format!("episode {index} is open in session {session}; close that one, or wait until it is");
                return wrong(Code::Busy, message);
            }
            EpisodeState::Played(_) => {
                return wrong(Code::Value, format!("episode {index} was played; open another one"));
            }
            EpisodeState::Failed { cause } => {
                return wrong(Code::Value, format!("episode {index} has failed ({cause}); open another one"));
            }
            EpisodeState::Waiting if episode.attempts >= MAX_ATTEMPTS => {
                return wrong(Code::Value, format!("episode {index} was begun {MAX_ATTEMPTS} times; open another one"));
            }
            EpisodeState::Waiting => {}
        }
        let others = state.siblings()?.prefix_of(index as usize, planned)?;
        let own = episode.prefix.clone();
        let prefix = own.into_iter().chain(others).max_by_key(|prefix| prefix.steps);
        let mut plan = plan::check(&register::request(spec, &planned.task, planned.seed))?;
        plan.ticket = Some(RunTicket {
            run: run.clone(),
            episode: index,
            attempt: episode.attempts + 1,
            hosted: ledger.is_hosted(),
            policy_version: spec.policy_version.clone(),
            policy_link: spec.policy_link.clone(),
        });
        Ok((plan, AssignedEpisode { run: Arc::clone(self), episode: index, prefix }))
    }

    /// Ends it: what was not decided has failed.
    /// Its journal is signed then, where the server has an identity that outlives it.
    pub fn finish(&self, signer: Option<&Identity>) -> Result<(), Refusal> {
        let mut state = lock(&self.state);
        state.flush()?;
        if state.writer.ledger().is_finished() {
            // Whose server died in between.
            return state.seal(signer);
        }
        let open: Vec<u32> = state.writer.ledger().open().map(|(index, _)| index).collect();
        if let Some(first) = open.first() {
            let message = format!(
                "{} episodes are open or their bags are being written, the first is {first}; close their sessions, and ask \
                 again in a moment",
                open.len()
            );
            return Err(Refusal::new(Code::Busy, "finish", message));
        }
        state.writer.append(Event::Finished { unix_ms: unix_ms() }).map_err(|error| not_written(&error))?;
        tracing::info!(run = state.writer.ledger().registration().run, "a run is finished");
        state.seal(signer)
    }

    /// Notes the end of an attempt.
    fn end(&self, episode: u32, event: Event) {
        let mut state = lock(&self.state);
        state.open.remove(&episode);
        state.pending.push_back(event);
        // The client learns of it when it asks for the state.
        let _ = state.flush();
    }
}

impl RunState {
    /// Writes pending events. What does not fit on a full disk stays pending, and its episode open, until there is
    /// room.
    fn flush(&mut self) -> Result<(), Refusal> {
        while let Some(event) = self.pending.pop_front() {
            let Err(error) = self.writer.append(event.clone()) else { continue };
            if !matches!(error, LedgerError::Event { .. }) {
                self.pending.push_front(event);
                return Err(not_written(&error));
            }
            tracing::error!(error = in_full(&error), ?event, "cannot write an event of a run");
        }
        Ok(())
    }

    fn seal(&mut self, signer: Option<&Identity>) -> Result<(), Refusal> {
        let Some(signer) = signer else { return Ok(()) };
        let sealed = self.writer.seal(|link| (signer.public().to_string(), sign_journal(signer, link)));
        sealed.map_err(|error| not_written(&error))
    }

    fn ledger(&self) -> &Ledger {
        self.writer.ledger()
    }

    fn siblings(&self) -> Result<Siblings, Refusal> {
        let folder = self.writer.path().parent().unwrap_or_else(|| Path::new(""));
        Siblings::read(folder, &self.ledger().registration().server)
    }
}
