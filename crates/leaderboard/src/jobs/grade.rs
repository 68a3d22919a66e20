//! Grades a submission: its results, the facts in them, whose rows they are, and the episodes to verify.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use fiatlux_access::{KnownServers, PublicKey};
use fiatlux_cli::in_full;
use fiatlux_grading::{
    BagRows, Conditions, EpisodeRow, ExcludedBag, Fault, GradeOptions, Results, RowsError, ScoreError, grade, patience,
    rows_of,
};

use crate::claims::{Facts, Label, Origin, origin};
use crate::store::{EpisodePlan, EpisodeRows, FileRow, Graded, Term, now_ms};
use crate::{Manifest, Service, Store, StoreError, SubmissionId};

/// Time limit for reading one bag. A bag of the largest size takes some seconds.
const MAX_TIME: Duration = Duration::from_secs(60);
const MAX_NAMED: usize = 3;

pub(super) async fn grade_one(service: &Arc<Service>, term: Term, id: SubmissionId) -> Result<(), StoreError> {
    let store = &service.store;
    let Some(entry) = store.entry(id).await? else { return Ok(()) };
    let files = store.files(id).await?;
    let start = now_ms();
    let folder = WorkFolder::make(service, id, &files).await?;
    let options = GradeOptions {
        workers: service.options.grade_workers,
        relative_to: folder.0.clone(),
        time_limit: Some(MAX_TIME),
        ..GradeOptions::default()
    };
    let path = folder.0.clone();
    let graded = tokio::task::spawn_blocking(move || {
        let graded = grade(std::slice::from_ref(&path), &options, &|_| {});
        let persons = graded.as_ref().map_or(Ok(Vec::new()), |results| persons_rows(&path, &results.excluded));
        (graded, persons)
    })
    .await;
    // Files that crashed the grader once would do so again.
    let (graded, persons) = match graded {
        // The service's own failure. Later submissions wait: those of this one may be copies of its rows.
        Ok((Err(ScoreError::Machine(error)), _)) => return Err(StoreError::Bag(error)),
        Ok((graded, persons)) => (graded.map_err(|error| in_full(&error).replace(&folder.prefix(), "")), persons?),
        Err(_) => (Err("the grader failed on these files; please report them".into()), Vec::new()),
    };
    drop(folder);
    for bag in persons {
        // A take is refused, but nobody may send its rows under another label.
        let rows = EpisodeRows { task: bag.task, seed: bag.seed, digest: bag.digest };
        store.know_persons(&id.to_string(), &entry.account, &bag.policy, &[rows]).await?;
    }
    let outcome = graded.and_then(|results| outcome(results, &entry.manifest, &files, &service.options.signers));
    // Submissions are graded in the order in which they were received: a graded one was received earlier.
    let outcome = match outcome {
        Ok(outcome) => match origin_of(store, &entry.account, &outcome.label, &outcome.rows).await? {
            Origin::Own { replaces } => Ok((outcome, replaces)),
            Origin::Refused(reason) => Err(reason),
        },
        Err(reason) => Err(reason),
    };
    match outcome {
        Err(reason) => {
            tracing::info!(submission = %id, reason, "refused");
            store.refuse_on(term, id, &reason).await
        }
        Ok((GradeOutcome { results, facts, episodes, label, rows }, replaces)) => {
            let json = results.to_json().map_err(|error| StoreError::corrupt("new results", error))?;
            let results = store.blobs.put(json.into_bytes()).await?;
            let account = &entry.account;
            let graded = Graded { account, results, facts, episodes, label, rows, replaces };
            if graded.facts.person {
                store.know_persons(&id.to_string(), account, &graded.label.policy, &graded.rows).await?;
            }
            store.set_graded(term, id, &graded).await?;
            let to_verify = graded.episodes.len();
            tracing::info!(submission = %id, hosted = graded.facts.hosted, to_verify, ms = now_ms() - start, "graded");
            Ok(())
        }
    }
}

/// Notes the rows of a submission that an older version of the service graded, or refuses it, as one of today.
pub(super) async fn index_one(service: &Arc<Service>, term: Term, id: SubmissionId) -> Result<(), StoreError> {
    let store = &service.store;
    let Some(entry) = store.entry(id).await? else { return Ok(()) };
    let Some(results) = store.results(id).await? else { return Ok(()) };
    let mut paths: Vec<PathBuf> = Vec::new();
    for digest in store.bags(id).await? {
        paths.push(store.blobs.local(&digest).await?);
    }
    let read = tokio::task::spawn_blocking(move || {
        let rows = paths.iter().filter_map(|path| rows_in_store(path).transpose());
        rows.map(|rows| rows.map(|bag| EpisodeRows { task: bag.task, seed: bag.seed, digest: bag.digest })).collect()
    });
    let rows: Result<Vec<EpisodeRows>, StoreError> =
        read.await.map_err(|_| StoreError::corrupt("the bags of a submission", "a thread ended early"))?;
    let rows = once(rows?);
    let label = label(&results);
    match origin_of(store, &entry.account, &label, &rows).await? {
        Origin::Refused(reason) => store.refuse_on(term, id, &reason).await,
        Origin::Own { replaces } => store.set_indexed(term, id, &entry.account, &label, &replaces, &rows).await,
    }
}

async fn origin_of(store: &Store, account: &str, label: &Label, rows: &[EpisodeRows]) -> Result<Origin, StoreError> {
    let (known, count) = store.known_rows(rows).await?;
    Ok(origin(account, label, &known, &count))
}

/// The rows of bags that were refused because a person drove.
fn persons_rows(folder: &Path, excluded: &[ExcludedBag]) -> Result<Vec<BagRows>, StoreError> {
    let takes = excluded.iter().filter(|bag| bag.reason == Fault::Kind);
    takes.filter_map(|bag| rows_in_store(&folder.join(&bag.bag)).transpose()).collect()
}

/// The rows of a bag; `None` if they cannot be read, such as those of an older layout, which no new bag can have.
///
/// # Errors
/// The machine failed, so that they may be read later.
fn rows_in_store(bag: &Path) -> Result<Option<BagRows>, StoreError> {
    match rows_of(bag, Some(patience(MAX_TIME, bag))) {
        Ok(rows) => Ok(Some(rows)),
        Err(RowsError::Bag(error)) if error.is_of_machine() => Err(StoreError::Bag(error)),
        Err(error) => {
            tracing::warn!(bag = %bag.display(), error = in_full(&error), "the rows of a bag are not known");
            Ok(None)
        }
    }
}

struct GradeOutcome {
    results: Results,
    facts: Facts,
    episodes: Vec<EpisodePlan>,
    label: Label,
    rows: Vec<EpisodeRows>,
}

fn label(results: &Results) -> Label {
    let Conditions { sensors, time, weights, meshes, .. } = &results.conditions;
    let mut senses = vec![time.clone()];
    senses.extend(sensors.iter().chain([weights, meshes]).filter(|text| !text.is_empty()).cloned());
    Label { policy: results.policy.clone(), senses: senses.join(", ") }
}

/// Each digest once.
fn once(rows: Vec<EpisodeRows>) -> Vec<EpisodeRows> {
    let by_digest: BTreeMap<String, EpisodeRows> = rows.into_iter().map(|rows| (rows.digest.clone(), rows)).collect();
    by_digest.into_values().collect()
}

/// The outcome of graded files, or the reason for which they are refused.
fn outcome(
    results: Results,
    manifest: &Manifest,
    files: &[FileRow],
    signers: &KnownServers,
) -> Result<GradeOutcome, String> {
    if let Some(reason) = losses(&results.excluded) {
        return Err(reason);
    }
    if results.policy != manifest.policy {
        let (said, played) = (&manifest.policy, &results.policy);
        return Err(format!("policy is '{said}' in the manifest and '{played}' in the bags; use the name in the bags"));
    }
    let facts = Facts::of(&results, is_hosted(&results, signers));
    let places: BTreeMap<&str, i64> = files.iter().map(|file| (file.name.as_str(), file.place)).collect();
    let (mut episodes, mut seen) = (Vec::new(), BTreeSet::new());
    let mut with_rows: BTreeMap<&str, &EpisodeRow> = BTreeMap::new();
    for row in results.episodes.iter().filter(|row| row.failure.is_none()) {
        let place = places.get(row.bag.as_str()).copied();
        let place = place.ok_or_else(|| format!("{}: the bag is not among the files", row.bag))?;
        if !seen.insert((row.task.as_str(), row.seed, row.episode)) {
            return Err(format!(
                "{}: a second bag of {}, seed {}, episode {}",
                row.bag, row.task, row.seed, row.episode
            ));
        }
        // Where the room and the start are fixed, two seeds may be one episode.
        if let Some(first) = with_rows.insert(&row.rows_digest, row)
            && facts.deviation.is_empty()
        {
            let ((bag, other), seed) = ((&row.bag, &first.bag), first.seed);
            return Err(format!(
                "{bag}: its rows are those of {other}, which is of seed {seed}; two rooms are never equal"
            ));
        }
        episodes.push(EpisodePlan { task: row.task.clone(), seed: row.seed, episode: row.episode, place });
    }
    if episodes.is_empty() {
        return Err("no episode was played to its end".into());
    }
    let rows = with_rows.into_values().map(|row| EpisodeRows {
        task: row.task.clone(),
        seed: row.seed,
        digest: row.rows_digest.clone(),
    });
    let rows = rows.collect();
    Ok(GradeOutcome { label: label(&results), facts, episodes, rows, results })
}

/// Names the bags that cannot be scored, with the reason; ignores second copies of scored ones.
fn losses(excluded: &[ExcludedBag]) -> Option<String> {
    let lost: Vec<&ExcludedBag> = excluded.iter().filter(|bag| bag.reason != Fault::Duplicate).collect();
    let named = lost.iter().take(MAX_NAMED).map(|bag| format!("{}: {}: {}", bag.bag, bag.reason.name(), bag.detail));
    let mut reason = named.collect::<Vec<_>>().join("; ");
    if lost.len() > MAX_NAMED {
        reason += &format!("; and {} more bags", lost.len() - MAX_NAMED);
    }
    (!lost.is_empty()).then_some(reason)
}

/// True if a finished run was played by the board's own servers in rooms that they drew. Their signatures prove it: those of
/// the bags, which cover the header with its index in the run and the origin of the seed, and those of the journals,
/// without which episodes or attempts could be left out.
fn is_hosted(results: &Results, signers: &KnownServers) -> bool {
    let is_known = |key: &str| key.parse::<PublicKey>().is_ok_and(|key| signers.name_of(&key).is_some());
    let run = results.run.as_ref().is_some_and(|run| {
        let is_signed = !run.signed_by.is_empty() && run.signed_by.iter().all(|key| is_known(key));
        run.hosted && run.finished && run.played > 0 && is_signed
    });
    let mut played = results.episodes.iter().filter(|row| row.failure.is_none());
    run && results.conditions.seeds == "hosted" && played.all(|row| row.signed_by.as_deref().is_some_and(is_known))
}

/// A folder with the files of a submission under their names; removed when it is dropped.
struct WorkFolder(PathBuf);

impl WorkFolder {
    async fn make(service: &Service, id: SubmissionId, files: &[FileRow]) -> Result<Self, StoreError> {
        let path = service.store.work(id);
        let failed = |_| StoreError::corrupt("the files of a submission", "a thread ended early");
        let make = move || {
            // Left over from a service that was killed.
            drop(std::fs::remove_dir_all(&path));
            std::fs::create_dir_all(&path).map_err(StoreError::io("make", &path))?;
            Ok::<_, StoreError>(Self(path))
        };
        let folder = tokio::task::spawn_blocking(make).await.map_err(failed)??;
        for file in files {
            let Some(digest) = crate::store::Digest::parse(&file.sha256) else { continue };
            let (from, to) = (service.store.blobs.local(&digest).await?, folder.0.join(&file.name));
            let linked = tokio::task::spawn_blocking(move || link(&from, &to).map_err(StoreError::io("read", &from)));
            linked.await.map_err(failed)??;
        }
        Ok(folder)
    }

    /// The path in front of file names in messages.
    fn prefix(&self) -> String {
        self.0.join("").display().to_string()
    }
}

impl Drop for WorkFolder {
    fn drop(&mut self) {
        if let Err(error) = std::fs::remove_dir_all(&self.0) {
            tracing::warn!(%error, folder = %self.0.display(), "cannot remove a folder of the grader");
        }
    }
}

/// Gives a file a second name; copies it if the file system has no links.
fn link(from: &Path, to: &Path) -> std::io::Result<()> {
    match std::fs::hard_link(from, to) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => std::fs::copy(from, to).map(drop),
        linked => linked,
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    /// Guards that a refusal tells the submitter name, kind and reason of the first bags that cannot be scored.
    #[test]
    fn a_refusal_names_the_bags() {
        let bag = |name: &str, reason| ExcludedBag {
            bag: name.into(),
            reason,
            detail: "row 7 is odd".into(),
            task: None,
            seed: None,
            episode: None,
            steps: 0,
            gate_progress: 0.0,
        };
        assert_eq!(losses(&[bag("a.mcap", Fault::Duplicate)]), None);
        let bags: Vec<_> = ["a", "b", "c", "d", "e"].map(|name| bag(name, Fault::Altered)).into();
        let reason = losses(&bags).unwrap();
        assert!(reason.starts_with("a: altered: row 7 is odd; b: "), "{reason}");
        assert!(reason.ends_with("; and 2 more bags"), "{reason}");
    }
}
