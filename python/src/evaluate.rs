//! Runs the benchmark in this process and records bags, with a server and a client.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc;

use fiatlux_batch::ActionForm;
use fiatlux_cli::in_full;
use fiatlux_client::{RunOptions, RunProgress};
use fiatlux_grading::report;
use fiatlux_runs::{EvaluateError, ExternalOptions, ExternalProgress, Outcome, evaluate_external};
use pyo3::prelude::*;

use crate::client::{Failure, Run, play, tell};
use crate::fault::{FiatluxError, check_process};
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
    progress: Option<Py<PyAny>>,
) -> PyResult<(String, Vec<String>)> {
    check_process()?;
    let form = settings.action_form()?;
    let (settings, weights) = settings.split_weights();
    std::fs::create_dir_all(&out)?;
    let options = run.options(&settings)?;
    let hosting = ExternalOptions {
        name: SERVER.into(),
        out: out.clone(),
        workers: std::thread::available_parallelism().map_or(1, usize::from),
        weights,
        meshes: None,
    };
    let failure = Failure::default();
    let noted = failure.clone();
    let played = watch(
        py,
        move |stop, tell| {
            let failure = Failure { stop: Arc::clone(stop), ..noted };
            host(&hosting, &options, make_player, form, &failure, &mut |progress| tell(progress.clone()))
        },
        |py, step| tell(py, progress.as_ref(), &step),
    )?;
    failure.check()?;
    let outcome = played.map_err(FiatluxError::new_err)?;
    let text = outcome.results.to_json().map_err(|error| FiatluxError::new_err(error.to_string()))?;
    write(&out, "results.json", &text)?;
    write(&out, "report.html", &report::html(&outcome.results))?;
    Ok((text, outcome.lost))
}

fn write(out: &Path, name: &str, text: &str) -> PyResult<()> {
    fiatlux_cli::write_whole(&out.join(name), text).map_err(Into::into)
}

/// Serves the run in this process, and plays it.
fn host(
    hosting: &ExternalOptions,
    options: &RunOptions,
    make_player: Py<PyAny>,
    form: ActionForm,
    failure: &Failure,
    progress: &mut dyn FnMut(&RunProgress),
) -> Result<Outcome, String> {
    let (sender, waiting) = mpsc::channel();
    let carrier = fiatlux_carrier::memory();
    let over = AtomicBool::new(false);
    let (played, served) = std::thread::scope(|scope| {
        let server = scope.spawn(|| {
            // Moved in here: if the server cannot start, dropping it ends the wait below.
            let sender = sender;
            evaluate_external(carrier.clone(), hosting, &over, &mut |progress| {
                if matches!(progress, ExternalProgress::Waiting) {
                    let _ = sender.send(());
                }
            })
        });
        // A run that is already finished starts no server.
        let played = waiting
            .recv()
            .ok()
            .map(|()| play(&carrier, options, make_player, form, failure, progress).map_err(|error| in_full(&error)));
        let is_whole = matches!(&played, Some(Ok(outcome)) if outcome.finished);
        over.store(!is_whole, Ordering::Relaxed);
        (played, server.join())
    });
    let outcome = served.map_err(|_| "the server has a fault, described on stderr; please report it".to_owned())?;
    match (played, outcome) {
        (Some(Err(reason)), _) => Err(reason),
        // The client knows more about it than the server's journal.
        (Some(Ok(run)), Err(EvaluateError::Nothing { .. })) => {
            let reasons = run
                .episodes
                .iter()
                .map(|one| format!("\n  {} seed {}: {}", one.task, one.seed.unwrap_or(0), one.cause));
            Err(format!("no episode was played to its end:{}", reasons.collect::<String>()))
        }
        (_, outcome) => outcome.map_err(|error| in_full(&error)),
    }
}
