//! Compares a `results.json` with the bags in its folder.

use std::path::Path;

use crate::compare::MAX_RESULTS_BYTES;
use crate::flaw::first_difference;
use crate::{EpisodeRow, Fault, Results};

/// The first contradiction between the `results.json` in this folder and `results`, which its bags gave, as a sentence;
/// `None` if they agree, or there is no file.
pub fn false_claim(folder: &Path, results: &Results) -> Option<String> {
    let file = folder.join("results.json");
    if !file.is_file() {
        return None;
    }
    let name = file.display();
    let claim: Results = match fiatlux_files::read(&file, MAX_RESULTS_BYTES)
        .map_err(|error| error.to_string())
        .and_then(|bytes| serde_json::from_slice(&bytes).map_err(|error| error.to_string()))
    {
        Ok(claim) => claim,
        Err(error) => return Some(format!("{name} cannot be compared with the bags: {error}")),
    };
    if claim.run.is_some() && results.run.is_none() {
        return Some(format!("{name} is of a run, but its folder has no journal of one (*.run.jsonl)"));
    }
    if claim.run.is_none() && results.run.is_some() {
        return Some(format!(
            "{name} is of loose bags, but its folder has the journal of a run; grade the folder again"
        ));
    }
    // Rounds both alike.
    let results: Results = serde_json::from_str(&results.to_json().ok()?).ok()?;
    let difference = first_difference(&comparable(&results, &results), &comparable(&claim, &results))?;
    let (field, bags, claimed) = (difference.field, difference.found, difference.recorded);
    let hint = if is_part(&claim, &results) {
        format!(
            "; it has a part of the episodes, as after a second evaluation with other tasks or seeds: to make it anew, run \
             scorer grade {} --json --out {name}",
            folder.display()
        )
    } else {
        String::new()
    };
    Some(format!("{name} contradicts the bags: {field} is {bags} by the bags, {claimed} in the file{hint}"))
}

/// True if a file has some of the bags' episodes, and no others.
fn is_part(claim: &Results, results: &Results) -> bool {
    let is_same = |a: &EpisodeRow, b: &EpisodeRow| {
        (&a.task, a.seed, a.episode, &a.state_digest) == (&b.task, b.seed, b.episode, &b.state_digest)
    };
    let is_there = |row: &EpisodeRow| results.episodes.iter().any(|other| is_same(row, other));
    claim.episodes.len() < results.episodes.len() && claim.episodes.iter().all(is_there)
}

/// Removes the fields that depend on where and by which version the bags were graded.
fn comparable(results: &Results, versions_of: &Results) -> Results {
    let mut results = Results { versions: versions_of.versions.clone(), ..results.clone() };
    if results.conditions.source.is_empty() {
        // Files of older versions lack it.
        results.conditions.source.clone_from(&versions_of.conditions.source);
    }
    // Files of older versions lack it; it follows from the seeds' rows.
    let subtasks = versions_of.score.subtasks;
    results.score.subtasks = subtasks;
    results.score_strict.iter_mut().for_each(|score| score.subtasks = subtasks);
    results.episodes.iter_mut().for_each(|row| {
        row.bag.clear();
        // Files of older versions lack it, and `state_digest` says the same.
        row.rows_digest.clear();
    });
    for excluded in &mut results.excluded {
        excluded.bag.clear();
        // It names the other bag.
        if excluded.reason == Fault::Duplicate {
            excluded.detail.clear();
        }
    }
    results.run.iter_mut().for_each(|run| run.folder.clear());
    results
}
