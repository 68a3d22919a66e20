//! The folders of a run: its journals' record of each episode, over all servers that took part, and over the parts in which one
//! evaluation was played.

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
    folders: Vec<PathBuf>,
    /// At least one. Shards of one evaluation are several: each was registered by itself.
    parts: Vec<Part>,
    servers: BTreeSet<String>,
    /// Keys of the servers that signed their finished journals; empty if one of the journals is not signed.
    signers: BTreeSet<PublicKey>,
    /// Of all parts.
    pub episodes: Vec<RunEpisode>,
    notes: Vec<String>,
}

/// Part of a run that was registered at once.
#[derive(Debug)]
struct Part {
    /// Registration in the first journal; the others agree in the fields used here.
    registration: Registration,
    finished: bool,
}

#[derive(Debug)]
pub(crate) struct RunEpisode {
    pub task: Task,
    pub seed: u64,
    /// Index of its part, and its index in the part's registration.
    part: usize,
    index: usize,
    /// Index of the folder with its bag.
    folder: usize,
    /// Number of attempts on all servers.
    attempts: u32,
    /// Number of attempts that ended because a server died.
    lost: u32,
    pub outcome: EpisodeOutcome,
}

/// A journal, and the index of its folder.
struct Journal {
    path: PathBuf,
    folder: usize,
    ledger: Ledger,
}

#[derive(Debug)]
pub(crate) enum EpisodeOutcome {
    /// The line of the journal, and the number of the attempt.
    Played(PlayedEpisode, u32),
    /// The cause, and further details.
    Failed(String, String),
}

impl RunJournals {
    /// Reads the journals in these folders: of one run, whose servers may have recorded into folders of their own, or of several
    /// runs of one policy in different rooms.
    pub fn read(folders: &[PathBuf]) -> Result<Self, ScoreError> {
        let (mut parts, mut servers, mut signers) = (Vec::<Part>::new(), BTreeSet::new(), Vec::new());
        let (mut episodes, mut notes) = (Vec::new(), Vec::new());
        for journals in parts_of(folders)? {
            let [first, others @ ..] = &journals[..] else { continue };
            let registration = first.ledger.registration().clone();
            for other in others {
                if let Some(field) = different(&registration, other.ledger.registration()) {
                    return Err(ScoreError::Journals { first: first.path.clone(), second: other.path.clone(), field });
                }
            }
            if let Some((server, other)) = registered_late(&journals) {
                return Err(ScoreError::Late { run: registration.run, server, other });
            }
            if let Some(known) = parts.first()
                && let Some(field) = other_evaluation(&known.registration, &registration)
            {
                let (first, second) = (folders[0].clone(), folders[first.folder].clone());
                return Err(ScoreError::Parts { first, second, field });
            }
            journal_notes(&journals, &mut notes)?;
            signers.push(signers_of(&journals, &mut notes)?);
            servers.extend(journals.iter().map(|journal| journal.ledger.registration().server.clone()));
            for (index, planned) in registration.episodes.iter().enumerate() {
                let task =
                    planned.task.parse().map_err(|source| ScoreError::Task { path: first.path.clone(), source })?;
                let on = journals.iter().map(|journal| On {
                    server: &journal.ledger.registration().server,
                    folder: journal.folder,
                    episode: &journal.ledger.episodes()[index],
                });
                let on: Vec<On<'_>> = on.collect();
                let name = format!("{task}, seed {}", planned.seed);
                let (outcome, folder) = outcome(&name, &on, &mut notes);
                episodes.push(RunEpisode {
                    task,
                    seed: planned.seed,
                    part: parts.len(),
                    index,
                    folder,
                    attempts: on.iter().map(|on| on.episode.attempts).sum(),
                    lost: on.iter().map(|on| on.episode.lost).sum(),
                    outcome,
                });
            }
            // One finished journal is enough: the other servers begin no more episodes, and one of them may be dead. Of a group, each has
            // its own episodes.
            let has_finished = |server: &String| {
                journals
                    .iter()
                    .any(|Journal { ledger, .. }| ledger.registration().server == *server && ledger.is_finished())
            };
            let finished = match &registration.group[..] {
                [] => journals.iter().any(|journal| journal.ledger.is_finished()),
                group => group.iter().all(has_finished),
            };
            for server in &registration.group {
                if !journals.iter().any(|journal| journal.ledger.registration().server == *server) {
                    notes.push(format!("the journal of server {server} is missing; its episodes count as failures"));
                }
            }
            parts.push(Part { registration, finished });
        }
        let all_signed = signers.iter().all(|signers: &BTreeSet<PublicKey>| !signers.is_empty());
        Ok(Self {
            folders: folders.to_vec(),
            signers: if all_signed { signers.into_iter().flatten().collect() } else { BTreeSet::new() },
            episodes: without_repeated(episodes, folders, &mut notes)?,
            parts,
            servers,
            notes,
        })
    }

    /// Index and bag of each episode that was played; the bag may be missing.
    pub fn bags(&self) -> Vec<(usize, PathBuf)> {
        let bag = |(index, episode): (usize, &RunEpisode)| match &episode.outcome {
            EpisodeOutcome::Played(played, _) => Some((index, self.folders[episode.folder].join(&played.bag))),
            EpisodeOutcome::Failed(..) => None,
        };
        self.episodes.iter().enumerate().filter_map(bag).collect()
    }

    /// Registration of the first part. Others have the same policy and session.
    fn registration(&self) -> &Registration {
        &self.parts[0].registration
    }

    pub fn policy(&self) -> &str {
        &self.registration().spec.policy
    }

    pub fn spec(&self) -> &fiatlux_proto::v3::RunSpec {
        &self.registration().spec
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
        let Registration { run: name, spec, .. } = &self.parts[episode.part].registration;
        let fields = [
            ("its run", run, name.clone()),
            ("its index in the run", place.to_string(), episode.index.to_string()),
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
        let spec = self.spec();
        let mut failed = BTreeMap::new();
        failures.iter().for_each(|failure| *failed.entry(failure.cause.clone()).or_insert(0) += 1);
        let count = |is: fn(&RunEpisode) -> bool| self.episodes.iter().filter(|episode| is(episode)).count() as u64;
        let folder = relative(&self.folders[0], relative_to);
        let names: Vec<&str> = self.parts.iter().map(|part| part.registration.run.as_str()).collect();
        RunResult {
            name: names.join("+"),
            folder: if folder.is_empty() { ".".into() } else { folder },
            policy_version: spec.policy_version.clone(),
            policy_link: spec.policy_link.clone(),
            servers: self.servers.iter().cloned().collect(),
            finished: self.parts.iter().all(|part| part.finished),
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

/// The journals in these folders, those of each run together, in the order of the folders.
fn parts_of(folders: &[PathBuf]) -> Result<Vec<Vec<Journal>>, ScoreError> {
    let mut parts: Vec<Vec<Journal>> = Vec::new();
    for (folder, path) in folders.iter().enumerate() {
        let read = |path: PathBuf| Ledger::read(&path).map(|ledger| Journal { path, folder, ledger });
        let journals = journals(path)?.into_iter().map(read).collect::<Result<Vec<_>, _>>()?;
        let first = journals.first().ok_or_else(|| ScoreError::NoBags(path.display().to_string()))?;
        let name = |journal: &Journal| {
            let Registration { run, key_sha256, .. } = journal.ledger.registration();
            (run.clone(), key_sha256.clone())
        };
        let is_same = |part: &&mut Vec<Journal>| part.first().is_some_and(|known| name(known) == name(first));
        match parts.iter_mut().find(is_same) {
            Some(part) => part.extend(journals),
            None => parts.push(journals),
        }
    }
    Ok(parts)
}

/// The first difference between two runs for which they cannot be parts of one evaluation.
fn other_evaluation(first: &Registration, second: &Registration) -> Option<&'static str> {
    let [one, two] = [&first.spec, &second.spec];
    let fields = [
        ("policies", one.policy == two.policy),
        ("versions of the policy", one.policy_version == two.policy_version),
        ("links of the policy", one.policy_link == two.policy_link),
        ("sessions", one.session == two.session),
        ("versions of the server", first.version == second.version),
        ("hosted seeds, which are each run's own", one.hosted_seeds == 0 && two.hosted_seeds == 0),
    ];
    fields.into_iter().find(|(_, is_same)| !is_same).map(|(field, _)| field)
}

/// Leaves out episodes that another part has too.
///
/// # Errors
/// The two differ: only their owner knows which one counts.
fn without_repeated(
    episodes: Vec<RunEpisode>,
    folders: &[PathBuf],
    notes: &mut Vec<String>,
) -> Result<Vec<RunEpisode>, ScoreError> {
    let is_not_run =
        |episode: &RunEpisode| matches!(&episode.outcome, EpisodeOutcome::Failed(why, _) if why == NOT_RUN);
    let mut kept: Vec<RunEpisode> = Vec::with_capacity(episodes.len());
    let mut places = BTreeMap::new();
    for episode in episodes {
        let room = (episode.task.to_string(), episode.seed);
        let Some(&place) = places.get(&room) else {
            places.insert(room, kept.len());
            kept.push(episode);
            continue;
        };
        let first: &RunEpisode = &kept[place];
        let is_same = match (&first.outcome, &episode.outcome) {
            (EpisodeOutcome::Played(one, _), EpisodeOutcome::Played(two, _)) => {
                one.digest.eq_ignore_ascii_case(&two.digest)
            }
            _ => is_not_run(first) || is_not_run(&episode),
        };
        if !is_same {
            let [first, second] = [first, &episode].map(|episode| folders[episode.folder].clone());
            return Err(ScoreError::Twice { task: room.0, seed: room.1, first, second });
        }
        notes.push(format!("{}, seed {} is in two parts, and counts once", room.0, room.1));
        if is_not_run(first) {
            kept[place] = episode;
        }
    }
    Ok(kept)
}

/// Remarks on the journals as files. Two journals of one server are refused: only their owner knows which one is true.
fn journal_notes(journals: &[Journal], notes: &mut Vec<String>) -> Result<(), ScoreError> {
    let mut of_server = BTreeMap::new();
    for Journal { path, ledger, .. } in journals {
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
    Ok(())
}

/// The signers of the journals, if all are signed. A hosted run without signatures gets a remark.
fn signers_of(journals: &[Journal], notes: &mut Vec<String>) -> Result<BTreeSet<PublicKey>, ScoreError> {
    let mut signers = BTreeSet::new();
    let mut all = true;
    for Journal { path, ledger, .. } in journals {
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
        ("group of servers", first.group == second.group),
    ];
    fields.into_iter().find(|(_, is_same)| !is_same).map(|(field, _)| field)
}

/// A server of a group where the run was registered after another one had finished it, and that one: hosted seeds were known by then.
fn registered_late(journals: &[Journal]) -> Option<(String, String)> {
    let of_group =
        journals.iter().map(|journal| &journal.ledger).filter(|ledger| !ledger.registration().group.is_empty());
    let ended = of_group.clone().filter_map(|ledger| Some((ledger.finished_ms()?, &ledger.registration().server)));
    let (end, other) = ended.min()?;
    let late = of_group.map(Ledger::registration).find(|registration| registration.unix_ms > end)?;
    Some((late.server.clone(), other.clone()))
}

/// An episode as one server's journal has it.
struct On<'a> {
    server: &'a str,
    folder: usize,
    episode: &'a LedgerEpisode,
}

/// The outcome of an episode over all servers, and the index of the folder with its bag. The first attempt counts, so of two
/// plays the one that was begun first does.
fn outcome(name: &str, on: &[On<'_>], notes: &mut Vec<String>) -> (EpisodeOutcome, usize) {
    let begun = |episode: &LedgerEpisode| episode.opened_ms.unwrap_or(u64::MAX);
    let played = on.iter().filter_map(|on| match &on.episode.state {
        EpisodeState::Played(played) => Some((on, played)),
        _ => None,
    });
    let Some((first, played)) = played.min_by_key(|(on, _)| (begun(on.episode), on.server)) else {
        return (failure(on), on.first().map_or(0, |on| on.folder));
    };
    let On { server, episode, .. } = first;
    for On { server: other, episode: also, .. } in on.iter().filter(|other| other.server != *server) {
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
    (EpisodeOutcome::Played(played.clone(), episode.attempts), first.folder)
}

/// The most informative reason among servers that did not play an episode: `not run` only if all of them say so.
fn failure(on: &[On<'_>]) -> EpisodeOutcome {
    let said = on.iter().map(|On { episode, .. }| match &episode.state {
        EpisodeState::Failed { cause } if cause == NOT_RUN => (0, cause.as_str()),
        EpisodeState::Failed { cause } if cause == ABANDONED => (2, cause.as_str()),
        EpisodeState::Failed { cause } => (3, cause.as_str()),
        EpisodeState::Waiting if episode.attempts > episode.lost => (2, ABANDONED),
        EpisodeState::Open { .. } => (1, OPEN),
        EpisodeState::Waiting | EpisodeState::Played(_) => (0, NOT_RUN),
    });
    let (rank, cause) = said.max_by_key(|(rank, _)| *rank).unwrap_or((0, NOT_RUN));
    let why = on.iter().map(|on| &on.episode.abandoned).find(|why| rank == 2 && !why.is_empty());
    EpisodeOutcome::Failed(cause.to_owned(), why.cloned().unwrap_or_default())
}
