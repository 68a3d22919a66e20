//! The main job: server, recorder, policies and scorer in one process. Nothing goes over a network.
//!
//! Every episode is a session like any other: the policy sees only messages, and the scorer sees only bags.
#![allow(missing_docs)] // Used in this repository alone.
mod demonstrate;
mod done;
mod external;
mod job;
mod lock;
mod losses;
mod play;

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

use fiatlux_client::{RunProgress, SessionArgs, check_tasks};
use fiatlux_grading::{Fault, Results};
use fiatlux_proto::plain;
use fiatlux_proto::v3::OpenRequest;
use fiatlux_server::ServerOptions;

pub use demonstrate::{BAGS, DemonstrateOptions, Demonstrated, Demonstration, demonstrate};
pub use external::{ExternalOptions, ExternalProgress, evaluate_external, evaluate_run};
pub use job::{EvaluateError, EvaluateOptions};
use job::{Job, SERVER, folder, grade, job_bags};
use lock::lock;
use losses::Played;

/// The outcome of an evaluation.
#[derive(Debug)]
pub struct Outcome {
    /// Scores of all whole bags.
    pub results: Results,
    /// Number of episodes that were already in the folder.
    pub resumed: usize,
    /// Episodes that were not played or not recorded whole, each with the reason.
    pub lost: Vec<String>,
    /// Number of episodes in the folder, with those that are still to be played.
    pub asked: usize,
    /// It was stopped before the end.
    pub stopped: bool,
}

/// Plays, records and grades. Setting `stop` ends it early: whatever is finished by then is graded, and a later call
/// with the same options continues.
///
/// # Errors
/// [`EvaluateError`]; finished bags stay in the folder.
pub fn evaluate(
    options: &EvaluateOptions,
    stop: &AtomicBool,
    progress: &mut dyn FnMut(&RunProgress),
) -> Result<Outcome, EvaluateError> {
    // Report a wrong name before anything is played.
    let policy = options.policies.make(&options.policy)?;
    check_tasks(policy.as_ref(), &options.tasks)?;
    check_names(&options.session)?;
    let bags = options.out.join(fiatlux_bag::BAGS);
    std::fs::create_dir_all(&bags).map_err(|error| folder(&bags, error))?;
    let _lock = lock(&options.out)?;
    let mut jobs = options.jobs()?;
    jobs.extend(earlier(&jobs, &bags)?);
    // A client that failed keeps its place until the grace time is over.
    let server = ServerOptions {
        name: SERVER.into(),
        workers: options.workers,
        // Half of the places are reserved for peers that have none, and all of these clients are one peer.
        capacity: 2 * jobs.len().max(1),
        weights: options.weights.clone(),
        meshes: options.meshes.clone(),
        scene: options.scene.clone(),
        ..ServerOptions::default()
    };
    let todo = done::not_done(&jobs, &bags, options, policy.as_ref())?;
    let resumed = jobs.len() - todo.len();
    let played = match todo.is_empty() {
        true => Played::default(),
        false => play::play(&todo, &bags, server, options, stop, progress)?,
    };
    let (recorded, missing): (Vec<Job>, Vec<Job>) = jobs.iter().partition(|job| bags.join(job.bag_name()).exists());
    let mut lost = played.lost(&missing);
    if recorded.is_empty() {
        if stop.load(Ordering::Relaxed) {
            return Err(EvaluateError::Stopped { episodes: jobs.len() });
        }
        return Err(EvaluateError::Nothing { lost: lost.join("\n  ") });
    }
    let results = grade(&job_bags(&recorded, &bags), options.workers, &options.out)?;
    let stopped = stop.load(Ordering::Relaxed);
    // What a stop interrupted is not lost: the same call plays it again.
    let excluded = results.excluded.iter().filter(|bag| !(stopped && bag.reason == Fault::Aborted));
    lost.extend(excluded.map(|bag| {
        // The client's reason says more than an aborted bag does.
        let job = jobs.iter().find(|job| bag.bag.ends_with(&job.bag_name()));
        format!("{}: {}", bag.bag, job.and_then(|job| played.reason(*job)).unwrap_or(&bag.detail))
    }));
    Ok(Outcome { results, resumed, lost, asked: jobs.len(), stopped })
}

/// Refuses a mistyped name of a sensor, a robot or a set of gains before a folder is made or judged by it.
///
/// # Errors
/// [`EvaluateError::Name`], with the nearest name.
pub fn check_names(session: &SessionArgs) -> Result<(), EvaluateError> {
    let mut request = OpenRequest::default();
    session.apply(&mut request);
    fiatlux_wire::check_names(&request)
        .map_err(|refusal| EvaluateError::Name { problem: plain(&refusal.message).into_owned() })
}

/// Episodes that an earlier call with other tasks or seeds left in the folder.
fn earlier(jobs: &[Job], bags: &Path) -> Result<Vec<Job>, EvaluateError> {
    let mut earlier = Vec::new();
    for entry in std::fs::read_dir(bags).map_err(|error| folder(bags, error))? {
        let path = entry.map_err(|error| folder(bags, error))?.path();
        if path.extension().is_none_or(|ending| ending != "mcap") || fiatlux_bag::is_leftover(&path) {
            continue;
        }
        let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
        match Job::of_bag(name) {
            Some(job) => earlier.push(job),
            None => return Err(folder(&path, "it is not an episode of an evaluation; move it elsewhere")),
        }
    }
    earlier.retain(|job| !jobs.contains(job));
    earlier.sort_by_key(|job| (job.task, job.seed));
    Ok(earlier)
}
