//! Runs the benchmark in this process and records bags, with a server and a client.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use fiatlux_bag::run::{EpisodeState, Ledger, LedgerEpisode, LedgerError, journal_of, journals};
use fiatlux_client::{RunOptions, RunProgress, SeedList, Shard, ShardRecord};
use fiatlux_grading::{GradeOptions, Results, grade, report};
use fiatlux_proto::v3::{OpenRequest, RunSpec};
use fiatlux_runs::{EvaluateError, ExternalOptions, evaluate_run};
use fiatlux_wire::check_request;
use fiatlux_world::{AssetArg, SceneConfig};
use pyo3::exceptions::{PyOSError, PyValueError};
use pyo3::prelude::*;

use crate::client::{Failure, Run, play, tell};
use crate::fault::{FiatluxError, check_process, failed, guarded, refused};
use crate::settings::Settings;
use crate::watch::watch;

/// Name of the server in this process.
const SERVER: &str = "evaluate";

/// Plays, records and grades a run in a folder, or the rest of it; returns the text of its `results.json`, and the missing
/// episodes with the reason.
#[pyfunction]
pub(crate) fn evaluate_into(
    py: Python<'_>,
    out: PathBuf,
    make_player: Py<PyAny>,
    run: Run,
    settings: Settings,
    assets: Vec<(String, PathBuf)>,
    thin: bool,
    goes_on: bool,
    progress: Option<Py<PyAny>>,
) -> PyResult<(String, Vec<String>)> {
    check_process()?;
    let form = settings.action_form()?;
    let (settings, weights) = settings.split_weights();
    let assets: Vec<AssetArg> = assets.into_iter().map(|(place, path)| AssetArg { place, path }).collect();
    let scene = SceneConfig::default().with_assets(&assets).map_err(|error| refused(&error))?;
    std::fs::create_dir_all(&out).map_err(|error| {
        std::io::Error::new(error.kind(), format!("cannot use the output folder {}: {error}", out.display()))
    })?;
    let (shard, part) = (run.shard()?, run.part(&settings)?);
    let options = RunOptions { is_alone: true, ..run.options(&settings)? };
    if let Some(shard) = shard {
        keep_record(&out, shard, &options.file.spec)?;
    }
    let hosting = ExternalOptions {
        // The journals of all shards come into one folder.
        name: shard.map_or_else(|| SERVER.into(), |shard| shard.name(SERVER)),
        out: out.clone(),
        thin,
        workers: std::thread::available_parallelism().map_or(1, usize::from),
        weights,
        meshes: None,
        scene,
        shard,
    };
    let failure = Failure { goes_on, ..Failure::default() };
    let noted = failure.clone();
    let played = watch(
        py,
        move |stop, tell| {
            let failure = Failure { stop: Arc::clone(stop), ..noted };
            let mut progress = |progress: &RunProgress| tell(progress.clone());
            evaluate_run(&hosting, |carrier| play(carrier, &options, make_player, part, form, &failure, &mut progress))
        },
        |py, step| tell(py, progress.as_ref(), &step),
    )?;
    failure.check()?;
    match played {
        Err(EvaluateError::Unplayed { lost }) if goes_on => {
            Ok((String::new(), lost.lines().map(|line| line.trim().to_owned()).collect()))
        }
        played => {
            let outcome = played.map_err(|error| failed(&error))?;
            Ok((written(&out, &outcome.results)?, outcome.lost))
        }
    }
}

/// Writes the results and their report; returns the text of the first.
fn written(out: &Path, results: &Results) -> PyResult<String> {
    let text = results.to_json().map_err(|error| FiatluxError::new_err(error.to_string()))?;
    write(out, "results.json", &text)?;
    write(out, "report.html", &report::html(results))?;
    Ok(text)
}

/// Checks a run before any of it is played, and makes its file; returns its name.
#[pyfunction]
pub(crate) fn begin_run(run: Run, settings: Settings) -> PyResult<String> {
    let RunOptions { file, .. } = run.options(&settings)?;
    for task in &file.spec.tasks {
        let request = OpenRequest { policy: run.name.clone(), task: task.clone(), ..settings.request(&run.record)? };
        check_request(&request)
            .map_err(|refusal| PyValueError::new_err(format!("{}: {}", refusal.field, refusal.message)))?;
    }
    Ok(file.run)
}

/// Of `count` shards of a run those, from 1 on, that are not whole in its folder.
#[pyfunction]
pub(crate) fn shards_left(folder: PathBuf, count: usize) -> PyResult<Vec<usize>> {
    let wrong = |error: LedgerError| FiatluxError::new_err(error.to_string());
    let known = |part: usize| Shard::new(part, count).map(|shard| (shard, journal_of(&folder, &shard.name(SERVER))));
    let shards: Vec<(Shard, PathBuf)> = (1..=count).filter_map(known).collect();
    let found = if folder.is_dir() { journals(&folder).map_err(wrong)? } else { Vec::new() };
    if let Some(other) = found.iter().find(|file| shards.iter().all(|(_, own)| own != *file)) {
        return Err(PyValueError::new_err(format!(
            "shard_size: {} is not of {count} shards; take the shard_size of the first call, or another folder",
            other.display()
        )));
    }
    let mut left = Vec::new();
    for (index, (shard, journal)) in shards.iter().enumerate() {
        let is_whole = |(_, episode): (usize, &LedgerEpisode)| match &episode.state {
            EpisodeState::Played(played) => folder.join(&played.bag).is_file(),
            EpisodeState::Failed { .. } => true,
            EpisodeState::Waiting | EpisodeState::Open { .. } => false,
        };
        let is_done = found.contains(journal)
            && Ledger::read(journal).is_ok_and(|ledger| {
                ledger.episodes().iter().enumerate().filter(|(index, _)| shard.has(*index)).all(is_whole)
            });
        if !is_done {
            left.push(index + 1);
        }
    }
    Ok(left)
}

/// Grades the folder of a run below `out`, and writes its results; returns their text, and the bags that cannot be scored.
#[pyfunction]
pub(crate) fn grade_run(py: Python<'_>, out: PathBuf, run: &str) -> PyResult<(String, Vec<String>)> {
    let options = GradeOptions { relative_to: out.clone(), ..GradeOptions::default() };
    let bags = [out.join("runs").join(run)];
    let results = py.detach(|| guarded(|| grade(&bags, &options, &|_| ())))?.map_err(|error| failed(&error))?;
    let lost = results.excluded.iter().map(|bag| format!("{}: {}", bag.bag, bag.detail)).collect();
    Ok((written(&out, &results)?, lost))
}

/// Notes in the folder which evaluation it has a shard of.
fn keep_record(out: &Path, shard: Shard, spec: &RunSpec) -> PyResult<()> {
    let episodes = spec.tasks.len() * spec.seeds.len();
    if !(0..episodes).any(|index| shard.has(index)) {
        return Err(PyValueError::new_err(format!(
            "shard {shard} has none of the {episodes} episodes; use fewer shards"
        )));
    }
    let record = ShardRecord {
        shard: shard.to_string(),
        tasks: spec.tasks.clone(),
        seeds: spec.seeds.clone(),
        again: "the same call of fiatlux.evaluate with shard='{shard}', out='{out}'".into(),
    };
    record.keep(out).map_err(|error| PyOSError::new_err(format!("{}: {error}", out.display())))
}

fn write(out: &Path, name: &str, text: &str) -> PyResult<()> {
    fiatlux_cli::write_whole(&out.join(name), text).map_err(Into::into)
}

/// Seeds of a text such as `0..3,7` or `fresh:64`; what was drawn is kept in the file `record`, and read from it again.
#[pyfunction]
pub(crate) fn parse_seeds(text: &str, record: Option<PathBuf>) -> PyResult<Vec<u64>> {
    let list: SeedList = text.parse().map_err(|error| PyValueError::new_err(format!("seeds is '{text}': {error}")))?;
    let list = match record {
        Some(file) => {
            list.recorded(&file).map_err(|error| PyOSError::new_err(format!("{}: {error}", file.display())))?
        }
        None => list,
    };
    Ok(list.seeds)
}
