//! Computes the benchmark's scores from episodes.

use fiatlux_rules::{Benchmark, Episode, Summary};
use pyo3::exceptions::PyKeyError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::build;

/// Combines summaries of episodes into the benchmark's scores, with the names of `results.json`.
#[pyfunction]
pub(crate) fn benchmark<'py>(py: Python<'py>, episodes: Vec<Bound<'py, PyDict>>) -> PyResult<Bound<'py, PyDict>> {
    let episodes = episodes.iter().map(read).collect::<PyResult<Vec<_>>>()?;
    let scores = Benchmark::of(&episodes);
    let dict = PyDict::new(py);
    let score = PyDict::new(py);
    score.set_item("mean", scores.score.map(|spread| spread.mean))?;
    score.set_item("std", scores.score.and_then(|spread| spread.std))?;
    dict.set_item("score", score)?;
    let mut subtasks = Vec::new();
    for subtask in &scores.subtasks {
        let row = PyDict::new(py);
        row.set_item("id", subtask.task.short_id())?;
        row.set_item("name", subtask.task.name())?;
        row.set_item("weight", subtask.task.weight())?;
        row.set_item("score_mean", subtask.score.mean)?;
        row.set_item("score_std", subtask.score.std)?;
        row.set_item("success_rate", subtask.success.value())?;
        row.set_item("clean_success_rate", subtask.clean_success.value())?;
        row.set_item("broken_rate", subtask.broken.value())?;
        row.set_item("dropped_rate", subtask.dropped.value())?;
        row.set_item("gate_progress", subtask.gate_progress)?;
        row.set_item("peak_hand_force_n", subtask.peak_hand_force_n)?;
        row.set_item("control_effort", subtask.control_effort)?;
        row.set_item("mean_steps", subtask.mean_steps)?;
        subtasks.push(row);
    }
    dict.set_item("subtasks", subtasks)?;
    dict.set_item("missing", scores.missing.iter().map(|task| task.short_id()).collect::<Vec<_>>())?;
    Ok(dict)
}

fn read(episode: &Bound<'_, PyDict>) -> PyResult<Episode> {
    fn get<'py, T: FromPyObjectOwned<'py>>(episode: &Bound<'py, PyDict>, key: &str) -> PyResult<T> {
        let value = episode.get_item(key)?;
        let value = value.ok_or_else(|| PyKeyError::new_err(format!("an episode's summary lacks '{key}'")))?;
        value.extract().map_err(Into::into)
    }
    let task: String = get(episode, "task")?;
    let summary = Summary {
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
    Ok(Episode { seed: get(episode, "seed")?, summary })
}
