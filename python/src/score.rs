//! Computes the benchmark's scores from episodes.

use std::collections::{BTreeMap, BTreeSet};

use fiatlux_rules::{Benchmark, Episode, Rate, Spread, SubtaskScore, Summary, Task};
use pyo3::exceptions::PyKeyError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::build;

/// Combines summaries of episodes into the benchmark's scores: the fields of `results.json` for loose bags.
#[pyfunction]
pub(crate) fn benchmark<'py>(py: Python<'py>, episodes: Vec<Bound<'py, PyDict>>) -> PyResult<Bound<'py, PyDict>> {
    let mut played = episodes.iter().map(read).collect::<PyResult<Vec<_>>>()?;
    // In the order of `results.json`: the last bit of a sum depends on it.
    played.sort_by_key(|played| (played.published.summary.task, played.published.seed));
    let published: Vec<Episode> = played.iter().map(|played| played.published).collect();
    let strict: Option<Vec<Episode>> = played.iter().map(|played| played.strict).collect();
    let strict = strict.filter(|strict| !strict.is_empty());
    let scores = Benchmark::of(&published);
    let dict = PyDict::new(py);
    let seeds: BTreeSet<u64> = published.iter().map(|episode| episode.seed).collect();
    dict.set_item("seeds", seeds.into_iter().collect::<Vec<_>>())?;
    dict.set_item("score", score(py, &scores)?)?;
    let score_strict = strict.as_deref().map(|strict| score(py, &Benchmark::of(strict))).transpose()?;
    dict.set_item("score_strict", score_strict)?;
    let (mut subtasks, mut extra_tasks) = (Vec::new(), Vec::new());
    for score in &scores.subtasks {
        let strict = strict.as_deref().and_then(|strict| SubtaskScore::of(score.task, strict));
        let rows = if Task::SUBTASKS.contains(&score.task) { &mut subtasks } else { &mut extra_tasks };
        rows.push(task(py, score, strict.as_ref(), ends(&played, score.task))?);
    }
    dict.set_item("subtasks", subtasks)?;
    dict.set_item("missing", scores.missing.iter().map(|task| task.short_id()).collect::<Vec<_>>())?;
    dict.set_item("overall", overall(py, &published, strict.as_deref())?)?;
    dict.set_item("extra_tasks", extra_tasks)?;
    Ok(dict)
}

/// An episode by both judges.
struct Played {
    published: Episode,
    strict: Option<Episode>,
    end: Option<String>,
}

fn score<'py>(py: Python<'py>, scores: &Benchmark) -> PyResult<Bound<'py, PyDict>> {
    let weight_total: f64 = Task::SUBTASKS.into_iter().map(Task::weight).sum();
    let mut per_seed = Vec::new();
    for seed in &scores.per_seed {
        let row = PyDict::new(py);
        row.set_item("seed", seed.seed)?;
        row.set_item("score", seed.score)?;
        row.set_item("weight_covered", seed.weight_covered)?;
        row.set_item("weight_total", weight_total)?;
        row.set_item("missing", seed.missing.iter().map(|task| task.short_id()).collect::<Vec<_>>())?;
        per_seed.push(row);
    }
    let dict = PyDict::new(py);
    dict.set_item("mean", scores.score.map(|spread| spread.mean))?;
    dict.set_item("std", scores.score.and_then(|spread| spread.std))?;
    dict.set_item("per_seed", per_seed)?;
    Ok(dict)
}

fn task<'py>(
    py: Python<'py>,
    score: &SubtaskScore,
    strict: Option<&SubtaskScore>,
    ends: BTreeMap<&str, u64>,
) -> PyResult<Bound<'py, PyDict>> {
    let row = PyDict::new(py);
    row.set_item("id", score.task.short_id())?;
    row.set_item("name", score.task.name())?;
    row.set_item("weight", score.task.weight())?;
    row.set_item("episodes", score.success.trials)?;
    row.set_item("ends", ends)?;
    row.set_item("gate_progress", score.gate_progress)?;
    row.set_item("episode_score", score.episode_score)?;
    row.set_item("peak_hand_force_n", score.peak_hand_force_n)?;
    row.set_item("control_effort", score.control_effort)?;
    row.set_item("mean_steps", score.mean_steps)?;
    row.set_item("strict_progress", strict.map(|strict| strict.gate_progress))?;
    for (prefix, score) in [("", Some(score)), ("strict_", strict)] {
        let spread: Option<Spread> = score.map(|score| score.score);
        row.set_item(format!("{prefix}score_mean"), spread.map(|spread| spread.mean))?;
        row.set_item(format!("{prefix}score_std"), spread.and_then(|spread| spread.std))?;
        let success = score.map(|score| score.success);
        let clean = score.map(|score| score.clean_success);
        let mut rates = vec![("success", success), ("clean_success", clean)];
        if prefix.is_empty() {
            rates.extend([("broken", score.map(|score| score.broken)), ("dropped", score.map(|score| score.dropped))]);
        }
        for (name, rate) in rates {
            row.set_item(format!("{prefix}{name}_rate"), rate.and_then(|rate| rate.value()))?;
            row.set_item(format!("{prefix}{name}_interval"), interval(rate))?;
        }
    }
    Ok(row)
}

/// Number of a task's episodes by the cause of their end.
fn ends(played: &[Played], task: Task) -> BTreeMap<&str, u64> {
    let mut ends = BTreeMap::new();
    let own = played.iter().filter(|played| played.published.summary.task == task);
    own.filter_map(|played| played.end.as_deref()).for_each(|end| *ends.entry(end).or_insert(0) += 1);
    ends
}

fn overall<'py>(py: Python<'py>, published: &[Episode], strict: Option<&[Episode]>) -> PyResult<Bound<'py, PyDict>> {
    let own = |episodes: &[Episode]| -> Vec<Summary> {
        let summaries = episodes.iter().map(|episode| episode.summary);
        summaries.filter(|summary| Task::SUBTASKS.contains(&summary.task)).collect()
    };
    let rate = |summaries: &[Summary], is: fn(&Summary) -> bool| {
        let rate = Rate::of(summaries.iter().map(is));
        let row = PyDict::new(py);
        row.set_item("hits", rate.hits)?;
        row.set_item("rate", rate.value())?;
        row.set_item("interval", interval(Some(rate)))?;
        Ok::<_, PyErr>(row)
    };
    let (published, strict) = (own(published), strict.map(own));
    let strict_rate = |is| strict.as_deref().map(|strict| rate(strict, is)).transpose();
    let dict = PyDict::new(py);
    dict.set_item("episodes", published.len())?;
    dict.set_item("clean_success", rate(&published, Summary::clean)?)?;
    dict.set_item("success", rate(&published, |summary| summary.success)?)?;
    dict.set_item("strict_success", strict_rate(|summary| summary.success)?)?;
    dict.set_item("strict_clean_success", strict_rate(Summary::clean)?)?;
    dict.set_item("broken", rate(&published, |summary| summary.broken)?)?;
    dict.set_item("dropped", rate(&published, |summary| summary.dropped)?)?;
    Ok(dict)
}

/// As a list, which is what JSON has.
fn interval(rate: Option<Rate>) -> Option<Vec<f64>> {
    rate.and_then(|rate| rate.interval()).map(|interval| interval.to_vec())
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
