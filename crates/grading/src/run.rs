//! The folder of a run: its journals' record of each episode, over all servers that took part.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use fiatlux_access::{PublicKey, Signer, journal_signer};
use fiatlux_bag::run::{
    ABANDONED, EpisodeState, Ledger, LedgerEpisode, NOT_RUN, PlayedEpisode, Registration, is_torn, journal_of, journals,
};
use fiatlux_proto::v3::{EpisodeHeader, RunTicket};
use fiatlux_rules::{Summary, Task};

use crate::ScoreError;
use crate::episode::GradedEpisode;
use crate::find::relative;
use crate::results::{Fault, RunFailure, RunResult};

/// Cause of an episode that a session still had when the journal ended.
const OPEN: &str = "open";
/// Cause of an episode that was played, but whose bag is missing or cannot be scored.
const BAG_LOST: &str = "bag lost";

#[derive(Debug)]
pub(crate) struct RunJournals {
    folder: PathBuf,
    /// Registration in the first journal; the others agree in the fields used here.
    registration: Registration,
    servers: BTreeSet<String>,
    finished: bool,
    /// Keys of the servers that signed their finished journals; empty if one of the journals is not signed.
    signers: BTreeSet<PublicKey>,
    /// By index.
    pub episodes: Vec<RunEpisode>,
    notes: Vec<String>,
}

#[derive(Debug)]
pub(crate) struct RunEpisode {
    pub task: Task,
    pub seed: u64,
    /// Number of attempts on all servers.
    attempts: u32,
    /// Number of attempts that ended because a server died.
    lost: u32,
    pub outcome: EpisodeOutcome,
}

#[derive(Debug)]
pub(crate) enum EpisodeOutcome {
    /// The line of the journal, and the number of the attempt.
    Played(PlayedEpisode, u32),
    /// The cause, and further details.
    Failed(String, String),
}

impl RunJournals {
    pub fn read(folder: &Path) -> Result<Self, ScoreError> {
        let paths = journals(folder)?;
        let ledgers = paths.iter().map(Ledger::read).collect::<Result<Vec<_>, _>>()?;
        let no_journal = || ScoreError::NoBags(folder.display().to_string());
        let first = ledgers.first().ok_or_else(no_journal)?.registration().clone();
        for (path, ledger) in paths.iter().zip(&ledgers) {
            if let Some(field) = different(&first, ledger.registration()) {
                return Err(ScoreError::Journals { first: paths[0].clone(), second: path.clone(), field });
            }
        }
        let mut notes = journal_notes(&paths, &ledgers)?;
        let signers = signers(&paths, &ledgers, &mut notes)?;
        let mut episodes = Vec::with_capacity(first.episodes.len());
        for (index, planned) in first.episodes.iter().enumerate() {
            let task = planned.task.parse().map_err(|source| ScoreError::Task { path: paths[0].clone(), source })?;
            let on = ledgers.iter().map(|ledger| (&*ledger.registration().server, &ledger.episodes()[index]));
            let on: Vec<(&str, &LedgerEpisode)> = on.collect();
            let name = format!("{task}, seed {}", planned.seed);
            episodes.push(RunEpisode {
                task,
                seed: planned.seed,
                attempts: on.iter().map(|(_, episode)| episode.attempts).sum(),
                lost: on.iter().map(|(_, episode)| episode.lost).sum(),
                outcome: outcome(&name, on, &mut notes),
            });
        }
        Ok(Self {
            folder: folder.into(),
            servers: ledgers.iter().map(|ledger| ledger.registration().server.clone()).collect(),
            // One finished journal is enough: the other servers begin no more episodes, and one of them may be dead.
            finished: ledgers.iter().any(Ledger::is_finished),
            signers,
            registration: first,
            episodes,
            notes,
        })
    }

    /// Index and bag of each episode that was played; the bag may be missing.
    pub fn bags(&self) -> Vec<(usize, PathBuf)> {
        let bag = |(index, episode): (usize, &RunEpisode)| match &episode.outcome {
            EpisodeOutcome::Played(played, _) => Some((index, self.folder.join(&played.bag))),
            EpisodeOutcome::Failed(..) => None,
        };
        self.episodes.iter().enumerate().filter_map(bag).collect()
    }

    pub fn policy(&self) -> &str {
        &self.registration.spec.policy
    }

    pub fn spec(&self) -> &fiatlux_proto::v3::RunSpec {
        &self.registration.spec
    }

    /// Seeds of all episodes, played or not.
    pub fn seeds(&self) -> BTreeSet<u64> {
        self.episodes.iter().map(|episode| episode.seed).collect()
    }

    /// The first difference between a bag and the one that the journal names for this episode.
    pub fn disagreement(&self, index: usize, header: &EpisodeHeader, graded: &GradedEpisode) -> Option<String> {
        let episode = self.episodes.get(index)?;
        let EpisodeOutcome::Played(played, attempt) = &episode.outcome else { return None };
        let RunTicket { run, episode: place, attempt: ticket_attempt, hosted, policy_version, policy_link } =
            header.run.clone().unwrap_or_default();
        let Registration { run: name, spec, .. } = &self.registration;
        let fields = [
            ("its run", run, name.clone()),
            ("its index in the run", place.to_string(), index.to_string()),
            ("its attempt", ticket_attempt.to_string(), attempt.to_string()),
            ("its task", graded.summary.task.to_string(), episode.task.to_string()),
            ("its seed", header.seed.to_string(), episode.seed.to_string()),
            ("whether its seed is hosted", hosted.to_string(), (spec.hosted_seeds > 0).to_string()),
            ("its policy", header.policy.clone(), spec.policy.clone()),
            ("its policy's version", policy_version, spec.policy_version.clone()),
            ("its policy's link", policy_link, spec.policy_link.clone()),
            ("the digest of its rows", graded.digest.to_ascii_lowercase(), played.digest.to_ascii_lowercase()),
        ];
        let (field, found, expected) = fields.into_iter().find(|(_, found, expected)| found != expected)?;
        Some(format!("the bag is not the one in the journal: {field} is '{found}', but '{expected}' in the journal"))
    }

    /// The episodes that count as failures, by index: those of the journals, and those whose bags are `lost`.
    pub fn failures(&self, lost: &BTreeMap<usize, (Fault, String)>) -> Vec<RunFailure> {
        let failure = |(index, episode): (usize, &RunEpisode)| {
            let (cause, detail) = match (&episode.outcome, lost.get(&index)) {
                (EpisodeOutcome::Played(..), None) => return None,
                (EpisodeOutcome::Played(..), Some((Fault::Altered, detail))) => {
                    (Fault::Altered.name().to_owned(), detail.clone())
                }
                (EpisodeOutcome::Played(..), Some((_, detail))) => (BAG_LOST.to_owned(), detail.clone()),
                (EpisodeOutcome::Failed(cause, detail), _) => (cause.clone(), detail.clone()),
            };
            Some(RunFailure {
                index: index as u64,
                task: episode.task.to_string(),
                seed: episode.seed,
                cause,
                detail,
                attempts: episode.attempts,
            })
        };
        self.episodes.iter().enumerate().filter_map(failure).collect()
    }

    /// The run as `results.json` shows it.
    pub fn result(&self, failures: Vec<RunFailure>, relative_to: &Path) -> RunResult {
        let spec = &self.registration.spec;
        let mut failed = BTreeMap::new();
        failures.iter().for_each(|failure| *failed.entry(failure.cause.clone()).or_insert(0) += 1);
        let count = |is: fn(&RunEpisode) -> bool| self.episodes.iter().filter(|episode| is(episode)).count() as u64;
        let folder = relative(&self.folder, relative_to);
        RunResult {
            name: self.registration.run.clone(),
            folder: if folder.is_empty() { ".".into() } else { folder },
            policy_version: spec.policy_version.clone(),
            policy_link: spec.policy_link.clone(),
            servers: self.servers.iter().cloned().collect(),
            finished: self.finished,
            hosted: spec.hosted_seeds > 0,
            signed_by: self.signers.iter().map(PublicKey::to_string).collect(),
            registered: self.episodes.len() as u64,
            played: (self.episodes.len() - failures.len()) as u64,
            failed,
            repeated: count(|episode| episode.attempts > 1),
            begun_again: count(|episode| episode.lost > 0),
            failures,
            notes: self.notes.clone(),
        }
    }
}

/// Remarks on the journals as files. Two journals of one server are refused: only their owner knows which one is true.
fn journal_notes(paths: &[PathBuf], ledgers: &[Ledger]) -> Result<Vec<String>, ScoreError> {
    let (mut notes, mut of_server) = (Vec::new(), BTreeMap::new());
    for (path, ledger) in paths.iter().zip(ledgers) {
        let server = &ledger.registration().server;
        if let Some(first) = of_server.insert(server, path) {
            let (first, second, server) = (first.clone(), path.clone(), server.clone());
            return Err(ScoreError::Copies { first, second, server });
        }
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        if is_torn(path)? {
            notes.push(format!(
                "{name} ends in a partial line, which does not count: its server died there, or it was cut"
            ));
        }
        if *path != journal_of(path.parent().unwrap_or(Path::new("")), server) {
            notes.push(format!("{name} is the journal of server {server} under another name"));
        }
    }
    Ok(notes)
}

/// The signers of the journals, if all are signed. A hosted run without signatures gets a remark.
fn signers(paths: &[PathBuf], ledgers: &[Ledger], notes: &mut Vec<String>) -> Result<BTreeSet<PublicKey>, ScoreError> {
    let mut signers = BTreeSet::new();
    let mut all = true;
    for (path, ledger) in paths.iter().zip(ledgers) {
        let signer = ledger.seal().map(|seal| journal_signer(&seal.of, &seal.key, &seal.signature));
        match signer {
            Some(Signer::Key(key)) => {
                signers.insert(key);
            }
            Some(Signer::Mismatch) => return Err(ScoreError::Seal(path.clone())),
            Some(Signer::Nobody) | None => {
                all = false;
                if ledger.is_hosted() && ledger.is_finished() {
                    let server = &ledger.registration().server;
                    notes.push(format!("the journal of {server} is not signed, so it may be incomplete"));
                }
            }
        }
    }
    Ok(if all { signers } else { BTreeSet::new() })
}

/// The summary of an episode that counts as a failure.
pub(crate) fn failed(task: Task) -> Summary {
    Summary {
        task,
        success: false,
        broken: false,
        dropped: false,
        gate_progress: 0.0,
        peak_hand_force_n: 0.0,
        control_effort: 0.0,
        steps: 0,
        end: None,
        reached_working_height: false,
    }
}

/// The first field in which two servers were registered for different runs.
fn different(first: &Registration, second: &Registration) -> Option<&'static str> {
    let fields = [
        ("name", first.run == second.run),
        ("key", first.key_sha256 == second.key_sha256),
        ("spec", first.spec == second.spec),
        ("list of episodes", first.episodes == second.episodes),
    ];
    fields.into_iter().find(|(_, is_same)| !is_same).map(|(field, _)| field)
}

/// The outcome of an episode over all servers. The first attempt counts, so of two plays the one that was begun first
/// does.
fn outcome(name: &str, on: Vec<(&str, &LedgerEpisode)>, notes: &mut Vec<String>) -> EpisodeOutcome {
    let begun = |episode: &LedgerEpisode| episode.opened_ms.unwrap_or(u64::MAX);
    let played = on.iter().filter_map(|(server, episode)| match &episode.state {
        EpisodeState::Played(played) => Some((*server, *episode, played)),
        _ => None,
    });
    let Some((server, episode, played)) = played.min_by_key(|(server, episode, _)| (begun(episode), *server)) else {
        return failure(&on);
    };
    for (other, also) in on.iter().filter(|(other, _)| *other != server) {
        match also.state {
            EpisodeState::Played(_) => {
                notes.push(format!("{name} was played on {server} and on {other}; {server} began it first and counts"));
            }
            _ if begun(also) < begun(episode) => {
                notes.push(format!("{name} was begun on {other} before it was begun and played on {server}"));
            }
            _ => {}
        }
    }
    EpisodeOutcome::Played(played.clone(), episode.attempts)
}

/// The most informative reason among servers that did not play an episode: `not run` only if all of them say so.
fn failure(on: &[(&str, &LedgerEpisode)]) -> EpisodeOutcome {
    let said = on.iter().map(|(_, episode)| match &episode.state {
        EpisodeState::Failed { cause } if cause == NOT_RUN => (0, cause.as_str()),
        EpisodeState::Failed { cause } if cause == ABANDONED => (2, cause.as_str()),
        EpisodeState::Failed { cause } => (3, cause.as_str()),
        EpisodeState::Waiting if episode.attempts > episode.lost => (2, ABANDONED),
        EpisodeState::Open { .. } => (1, OPEN),
        EpisodeState::Waiting | EpisodeState::Played(_) => (0, NOT_RUN),
    });
    let (rank, cause) = said.max_by_key(|(rank, _)| *rank).unwrap_or((0, NOT_RUN));
    let why = on.iter().map(|(_, episode)| &episode.abandoned).find(|why| rank == 2 && !why.is_empty());
    EpisodeOutcome::Failed(cause.to_owned(), why.cloned().unwrap_or_default())
}
