//! Serves a run: a server that records it here, and then grades it. Its policy connects from elsewhere, or plays in this process.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc;
use std::time::Duration;

use fiatlux_bag::run::{EpisodeState, Ledger, journal_of};
use fiatlux_carrier::Carrier;
use fiatlux_client::{EpisodeFate, EpisodeOutcome, Playing, RunError, RunOutcome, RunProgress, Shard};
use fiatlux_rules::Task;
use fiatlux_server::{Server, ServerOptions};
use fiatlux_world::SceneConfig;

use super::Outcome;
use super::job::{EvaluateError, folder, grade};
use super::lock::lock;

/// Time between two reads of the ledger.
const PERIOD: Duration = Duration::from_millis(250);
/// Longest time for bags to close when the server stops.
const CLOSING_TIME: Duration = Duration::from_secs(15);
/// Time for answering the client's last query before the server stops.
const FAREWELL: Duration = Duration::from_millis(500);

/// Options of an evaluation by a client from elsewhere.
#[derive(Debug, Clone)]
pub struct ExternalOptions {
    pub name: String,
    /// Folder for bags, results and report. It holds one run; an unfinished one is resumed.
    pub out: PathBuf,
    /// Keep bags thin, as of [`EvaluateOptions`](crate::EvaluateOptions).
    pub thin: bool,
    /// Threads that step episodes.
    pub workers: usize,
    /// Folder of weights that a session may name.
    pub weights: Option<PathBuf>,
    /// Folder of meshes that replace the built-in shapes of the robot.
    pub meshes: Option<PathBuf>,
    /// Scene that the server simulates.
    pub scene: SceneConfig,
    /// The part of the run that is played here; `None` for all of it.
    pub shard: Option<Shard>,
}

/// Progress of a run from elsewhere.
#[derive(Debug, Clone, PartialEq)]
pub enum ExternalProgress {
    /// The server can be reached, and no run is registered yet.
    Waiting,
    /// A run is under way.
    Playing {
        run: String,
        policy: String,
        /// Its episodes. How far an open one has come is not known, and its steps do not count before its end.
        progress: RunProgress,
    },
}

/// Serves one run on a carrier, and grades it when it is over. Setting `stop` ends it early: whatever is played by then is graded,
/// and a later call with the same options continues.
///
/// # Errors
/// [`EvaluateError`]; the run can still be continued.
pub fn evaluate_external(
    carrier: Carrier,
    options: &ExternalOptions,
    stop: &AtomicBool,
    progress: &mut dyn FnMut(&ExternalProgress),
) -> Result<Outcome, EvaluateError> {
    let runs = options.out.join("runs");
    std::fs::create_dir_all(&runs).map_err(|error| folder(&runs, error))?;
    let _lock = lock(&options.out)?;
    if let Some(journal) = find_run(&runs, &options.name)? {
        let ledger = read(&journal)?;
        if ledger.is_finished() {
            return outcome(options, &journal, &ledger, false);
        }
    }
    let server = ServerOptions {
        name: options.name.clone(),
        workers: options.workers,
        weights: options.weights.clone(),
        meshes: options.meshes.clone(),
        scene: options.scene.clone(),
        record: Some(runs.clone()),
        thin: options.thin,
        ..ServerOptions::default()
    };
    let server = Server::start(carrier, server)?;
    progress(&ExternalProgress::Waiting);
    let watched = watch(options, &runs, stop, progress);
    if !server.shutdown(CLOSING_TIME) {
        tracing::warn!("not everything was recorded within {} s", CLOSING_TIME.as_secs());
    }
    match watched? {
        // Without the server, open episodes are decided or can be begun again.
        Some(journal) => outcome(options, &journal, &read(&journal)?, stop.load(Ordering::Relaxed)),
        None => Err(EvaluateError::Nothing { lost: "no run was registered".into() }),
    }
}

/// Serves a run in this process, lets `play` play it there, and grades it. A later call with the same options continues it.
///
/// # Errors
/// As for [`evaluate_external`]; or the run cannot be played.
pub fn evaluate_run(
    options: &ExternalOptions,
    play: impl FnOnce(&Carrier) -> Result<RunOutcome, RunError>,
) -> Result<Outcome, EvaluateError> {
    let (sender, waiting) = mpsc::channel();
    let (carrier, over) = (fiatlux_carrier::memory(), AtomicBool::new(false));
    let (played, outcome) = std::thread::scope(|scope| {
        let server = scope.spawn(|| {
            // Moved in here: if the server cannot start, dropping it ends the wait below.
            let sender = sender;
            evaluate_external(carrier.clone(), options, &over, &mut |progress| {
                if matches!(progress, ExternalProgress::Waiting) {
                    let _ = sender.send(());
                }
            })
        });
        // A run that is already finished starts no server.
        let played = waiting.recv().ok().map(|()| play(&carrier));
        let is_whole = matches!(&played, Some(Ok(outcome)) if outcome.finished);
        over.store(!is_whole, Ordering::Relaxed);
        (played, server.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)))
    });
    let reason = |one: &EpisodeOutcome| format!("{} seed {}: {}", one.task, one.seed.unwrap_or(0), one.cause);
    match (played.transpose()?, outcome) {
        // The client knows more about it than the server's journal.
        (Some(run), Err(EvaluateError::Nothing { .. })) => {
            Err(EvaluateError::Unplayed { lost: run.episodes.iter().map(reason).collect::<Vec<_>>().join("\n  ") })
        }
        // What the policy could not play is in the journal without a reason.
        (Some(run), Ok(mut outcome)) if !run.stopped => {
            let lost = run.episodes.iter().filter(|one| one.fate == EpisodeFate::Lost).map(reason);
            outcome.lost.extend(lost);
            Ok(outcome)
        }
        (_, outcome) => outcome,
    }
}

/// Watches the run until it is over or `stop` is set; returns its journal, if there is one.
fn watch(
    options: &ExternalOptions,
    runs: &Path,
    stop: &AtomicBool,
    progress: &mut dyn FnMut(&ExternalProgress),
) -> Result<Option<PathBuf>, EvaluateError> {
    let mut journal = None;
    // Steps that were played before this call.
    let mut steps_before = None;
    while !stop.load(Ordering::Relaxed) {
        std::thread::sleep(PERIOD);
        if journal.is_none() {
            journal = find_run(runs, &options.name)?;
        }
        let Some(journal) = &journal else {
            progress(&ExternalProgress::Waiting);
            continue;
        };
        let ledger = read(journal)?;
        let before = *steps_before.get_or_insert_with(|| steps(&ledger));
        progress(&look(&ledger, before));
        if ledger.is_finished() {
            std::thread::sleep(FAREWELL);
            break;
        }
    }
    Ok(journal)
}

/// Journal of the first unfinished run in a folder, or else of the first run.
fn find_run(runs: &Path, server: &str) -> Result<Option<PathBuf>, EvaluateError> {
    let entries = std::fs::read_dir(runs).map_err(|error| folder(runs, error))?;
    let mut journals: Vec<PathBuf> = entries.flatten().map(|entry| journal_of(&entry.path(), server)).collect();
    journals.retain(|journal| journal.is_file());
    journals.sort();
    let is_over = |journal: &&PathBuf| Ledger::read(journal).is_ok_and(|ledger| ledger.is_finished());
    Ok(journals.iter().find(|journal| !is_over(journal)).or(journals.first()).cloned())
}

fn read(journal: &Path) -> Result<Ledger, EvaluateError> {
    Ok(Ledger::read(journal)?)
}

fn steps(ledger: &Ledger) -> u64 {
    let steps = |state: &EpisodeState| if let EpisodeState::Played(played) = state { played.steps } else { 0 };
    ledger.episodes().iter().map(|episode| steps(&episode.state)).sum()
}

fn look(ledger: &Ledger, steps_before: u64) -> ExternalProgress {
    let registration = ledger.registration();
    let mut progress = RunProgress {
        episodes: ledger.episodes().len(),
        steps: steps(ledger).saturating_sub(steps_before),
        ..RunProgress::default()
    };
    for (episode, planned) in ledger.episodes().iter().zip(&registration.episodes) {
        let horizon = planned.task.parse::<Task>().map_or(0, |task| task.horizon_steps());
        match &episode.state {
            EpisodeState::Played(played) => {
                progress.done += 1;
                progress.successes += usize::from(played.success);
            }
            EpisodeState::Failed { .. } => progress.done += 1,
            EpisodeState::Open { .. } => {
                let (task, seed) = (planned.task.clone(), Some(planned.seed));
                progress.playing.push(Playing { task, seed, ..Playing::default() });
                progress.steps_left += horizon;
            }
            EpisodeState::Waiting => progress.steps_left += horizon,
        }
    }
    ExternalProgress::Playing { run: registration.run.clone(), policy: registration.spec.policy.clone(), progress }
}

/// Grades the run: what was registered and not played counts as a failure.
fn outcome(
    options: &ExternalOptions,
    journal: &Path,
    ledger: &Ledger,
    stopped: bool,
) -> Result<Outcome, EvaluateError> {
    let bags = journal.parent().unwrap_or(Path::new(""));
    let mut any_played = false;
    let mut lost = Vec::new();
    let own = |(index, _): &(usize, _)| options.shard.is_none_or(|shard| shard.has(*index));
    let episodes = ledger.episodes().iter().zip(&ledger.registration().episodes).enumerate().filter(own);
    for (_, (episode, planned)) in episodes.clone() {
        match &episode.state {
            EpisodeState::Played(_) => any_played = true,
            EpisodeState::Failed { cause } => lost.push(format!("{} seed {}: {cause}", planned.task, planned.seed)),
            EpisodeState::Waiting | EpisodeState::Open { .. } => {}
        }
    }
    if !any_played {
        let lost = if lost.is_empty() { "no episode was played to its end".into() } else { lost.join("\n  ") };
        return Err(EvaluateError::Nothing { lost });
    }
    let results = grade(&[bags.to_path_buf()], options.workers, &options.out)?;
    lost.extend(results.excluded.iter().map(|bag| format!("{}: {}", bag.bag, bag.detail)));
    let asked = episodes.count();
    Ok(Outcome { results, resumed: 0, lost, asked, stopped: stopped && !ledger.is_finished() })
}
