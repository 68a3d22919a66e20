//! What a `results.json` says, compared with the bags in its folder.

use std::path::Path;

use crate::Results;
use crate::flaw::first_difference;

/// Where the `results.json` in this folder says otherwise than `results`, which its bags gave, in a sentence; `None` where it
/// agrees, or there is none.
pub fn false_claim(folder: &Path, results: &Results) -> Option<String> {
    let file = folder.join("results.json");
    if !file.is_file() {
        return None;
    }
    let name = file.display();
    let claim: Results = match std::fs::read(&file)
        .map_err(|error| error.to_string())
        .and_then(|bytes| serde_json::from_slice(&bytes).map_err(|error| error.to_string()))
    {
        Ok(claim) => claim,
        Err(error) => return Some(format!("{name} cannot be compared with the bags: {error}")),
    };
    if claim.run.is_some() && results.run.is_none() {
        return Some(format!("{name} is of a run, but its folder has no journal of one (*.run.jsonl)"));
    }
    // What JSON rounds, it rounds in both.
    let results: Results = serde_json::from_str(&results.to_json().ok()?).ok()?;
    let (mut found, claim) = (comparable(&results, &results), comparable(&claim, &results));
    // The same bags, once graded as a run and once as loose bags, have other scores.
    if claim.run.is_none() && found.run.is_some() {
        found = Results { policy: found.policy, episodes: found.episodes, ..claim.clone() };
    }
    let difference = first_difference(&found, &claim)?;
    let (field, bags, claimed) = (difference.field, difference.found, difference.recorded);
    Some(format!("{name} says otherwise than the bags: {field} is {bags} by the bags, {claimed} in the file"))
}

/// Leaves out what depends on where and by which version the bags were graded.
fn comparable(results: &Results, versions_of: &Results) -> Results {
    let mut results = Results { versions: versions_of.versions.clone(), ..results.clone() };
    results.episodes.iter_mut().for_each(|row| row.bag.clear());
    results.excluded.iter_mut().for_each(|bag| bag.bag.clear());
    results.run.iter_mut().for_each(|run| run.folder.clear());
    results
}
