//! Computes the benchmark's scores from episodes.

use std::collections::{BTreeMap, BTreeSet};

use fiatlux_grading::Scores;
use fiatlux_rules::{Episode, Summary, Task};
use pyo3::exceptions::{PyKeyError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::build;

/// Combines summaries of episodes into the benchmark's scores: the fields of `results.json` for loose bags.
#[pyfunction]
pub(crate) fn benchmark<'py>(py: Python<'py>, episodes: Vec<Bound<'py, PyDict>>) -> PyResult<Bound<'py, PyAny>> {
    let mut played = episodes.iter().map(read).collect::<PyResult<Vec<_>>>()?;
    // In the order of `results.json`: the last bit of a sum depends on it.
    played.sort_by_key(|played| (played.published.summary.task, played.published.seed));
    let published: Vec<Episode> = played.iter().map(|played| played.published).collect();
    let strict: Option<Vec<Episode>> = played.iter().map(|played| played.strict).collect();
    let strict = strict.filter(|strict| !strict.is_empty());
    let scores = Scores::of(&published, strict.as_deref(), |task| ends(&played, task));
    let text = serde_json::to_string(&scores).map_err(|error| PyValueError::new_err(error.to_string()))?;
    let scores = py.import("json")?.call_method1("loads", (text,))?;
    let seeds: BTreeSet<u64> = published.iter().map(|episode| episode.seed).collect();
    scores.set_item("seeds", seeds.into_iter().collect::<Vec<_>>())?;
    Ok(scores)
}

/// An episode by both judges.
struct Played {
    published: Episode,
    strict: Option<Episode>,
    end: Option<String>,
}

/// Number of a task's episodes by the cause of their end.
fn ends(played: &[Played], task: Task) -> BTreeMap<String, u64> {
    let mut ends = BTreeMap::new();
    let own = played.iter().filter(|played| played.published.summary.task == task);
    own.filter_map(|played| played.end.clone()).for_each(|end| *ends.entry(end).or_insert(0) += 1);
    ends
}

fn read(episode: &Bound<'_, PyDict>) -> PyResult<Played> {
    fn get<'py, T: FromPyObjectOwned<'py>>(episode: &Bound<'py, PyDict>, key: &str) -> PyResult<T> {
        let value = episode.get_item(key)?;
        let value = value.ok_or_else(|| PyKeyError::new_err(format!("an episode's summary lacks '{key}'")))?;
        value.extract().map_err(Into::into)
    }
    let task: String = get(episode, "task")?;
    let seed = get(episode, "seed")?;
    let published = Summary {
        task: build::task(&task)?,
        success: get(episode, "success")?,
        broken: get(episode, "broken")?,
        dropped: get(episode, "dropped")?,
        gate_progress: get(episode, "gate_progress")?,
        peak_hand_force_n: get(episode, "peak_hand_force_n")?,
        control_effort: get(episode, "control_effort")?,
        steps: get(episode, "steps")?,
        end: None,
        reached_working_height: false,
    };
    let strict = match get::<Option<bool>>(episode, "strict_success")? {
        None => None,
        Some(success) => {
            // A row has no `strict_broken`. All that the strict scores need of it is whether a success was clean.
            let broken = success && !get::<bool>(episode, "strict_clean")?;
            let gate_progress = get(episode, "strict_progress")?;
            let summary = Summary { success, broken, dropped: false, gate_progress, ..published };
            Some(Episode { seed, summary })
        }
    };
    Ok(Played { published: Episode { seed, summary: published }, strict, end: get(episode, "end")? })
}
