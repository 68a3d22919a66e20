//! The main job: server, recorder, policies and scorer in one process. Nothing goes over a network.
//!
//! Every episode is a session like any other: the policy sees only messages, and the scorer sees only bags.
mod done;
mod external;
mod lock;
mod losses;
mod play;
mod progress;

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use fiatlux_client::{Policy, PolicyError, SessionArgs, check_tasks};
use fiatlux_grading::{GradeOptions, Results, ScoreError, grade};
use fiatlux_proto::PROTOCOL;
use fiatlux_proto::v3::OpenRequest;
use fiatlux_rules::Task;
use fiatlux_server::{RecorderError, ServerError, ServerOptions};
use thiserror::Error;

pub use external::{ExternalOptions, ExternalProgress, evaluate_external};
use lock::lock;
use losses::Played;
pub use progress::Progress;

/// Name of the server in this process.
const SERVER: &str = "evaluate";

/// What to evaluate, where to put it, and how.
#[derive(Debug, Clone)]
pub struct EvaluateOptions {
    /// Name of the policy, in the form that `policy-client` accepts.
    pub policy: String,
    /// Tasks to play, each once.
    pub tasks: Vec<Task>,
    /// Layout seeds, each once; one episode of each task is played in each.
    pub seeds: Vec<u64>,
    /// Folder for bags, results and report, which are of everything in it. Whole bags of the same evaluation and version are
    /// kept; what an earlier call with other tasks or seeds left there belongs to this one.
    pub out: PathBuf,
    /// Number of episodes to play at once.
    pub workers: usize,
    /// Folder of weights that a session may name.
    pub weights: Option<PathBuf>,
    /// Folder of meshes that replace the built-in shapes of the robot.
    pub meshes: Option<PathBuf>,
    /// The request for every session, without policy, task and seed.
    pub session: SessionArgs,
}

/// One episode to play.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Job {
    task: Task,
    seed: u64,
}

impl EvaluateOptions {
    /// The request for a job's session.
    fn request(&self, job: Job, policy: &dyn Policy) -> OpenRequest {
        let mut request = OpenRequest {
            protocol: Some(PROTOCOL),
            policy: policy.name(),
            task: job.task.to_string(),
            seed: job.seed,
            sensors: policy.sensors(),
            recorded: true,
            ..OpenRequest::default()
        };
        self.session.apply(&mut request);
        request
    }
}

impl Job {
    /// Name of the job's bag inside the folder.
    fn bag_name(self) -> String {
        format!("{}-s{}-e0.mcap", self.task, self.seed)
    }

    /// The job whose bag has this name.
    fn of_bag(name: &str) -> Option<Self> {
        let (task, seed) = name.split_once("-s")?;
        let job = Self { task: task.parse().ok()?, seed: seed.strip_suffix("-e0.mcap")?.parse().ok()? };
        (job.bag_name() == name).then_some(job)
    }
}

/// The outcome of an evaluation.
#[derive(Debug)]
pub struct Outcome {
    /// Scores of all whole bags.
    pub results: Results,
    /// Number of episodes that were already in the folder.
    pub resumed: usize,
    /// Episodes that were not played or not recorded whole, each with the reason.
    pub lost: Vec<String>,
    /// Whether it was stopped before the end.
    pub stopped: bool,
}

/// Why an evaluation could not be carried out.
#[derive(Debug, Error)]
pub enum EvaluateError {
    /// The output folder cannot be used.
    #[error("cannot use the output folder {}: {problem}", path.display())]
    Folder {
        /// The folder or a file in it.
        path: PathBuf,
        /// What is wrong and what to do about it.
        problem: String,
    },
    /// The policy cannot be made.
    #[error(transparent)]
    Policy(#[from] PolicyError),
    /// The robot's file cannot be loaded.
    #[error("cannot load the robot")]
    Robot(#[from] fiatlux_robot::RobotError),
    /// The folder of meshes cannot be used.
    #[error("cannot use the meshes of the robot")]
    Meshes(#[from] fiatlux_render::MeshError),
    /// The system cannot draw a key.
    #[error("cannot draw a key for the recorder")]
    Key(#[from] fiatlux_access::AccessError),
    /// The server did not start.
    #[error("cannot start the server")]
    Server(#[from] ServerError),
    /// The recorder did not start.
    #[error("cannot start the recorder")]
    Recorder(#[from] RecorderError),
    /// No episode was recorded.
    #[error("no episode was recorded:\n  {lost}")]
    Nothing {
        /// The reason for each episode, on its own line.
        lost: String,
    },
    /// The ledger of a run cannot be read.
    #[error("cannot read the state of the run")]
    Ledger(#[from] fiatlux_bag::run::LedgerError),
    /// The bags cannot be graded.
    #[error("cannot grade the bags")]
    Score(#[from] ScoreError),
}

/// Plays, records and grades. Setting `stop` ends it early: whatever is finished by then is graded, and a later call
/// with the same options continues.
///
/// # Errors
/// [`EvaluateError`]; finished bags stay in the folder.
pub fn evaluate(
    options: &EvaluateOptions,
    stop: &Arc<AtomicBool>,
    progress: &mut dyn FnMut(&Progress),
) -> Result<Outcome, EvaluateError> {
    // Report a wrong name before anything is played.
    let policy = fiatlux_policies::by_name(&options.policy)?;
    check_tasks(policy.as_ref(), &options.tasks)?;
    let bags = options.out.join("bags");
    std::fs::create_dir_all(&bags).map_err(|error| folder(&bags, error))?;
    let _lock = lock(&options.out)?;
    let mut jobs: Vec<Job> =
        options.tasks.iter().flat_map(|&task| options.seeds.iter().map(move |&seed| Job { task, seed })).collect();
    jobs.extend(earlier(&jobs, &bags)?);
    // A client that failed keeps its place until the grace time is over.
    let server = ServerOptions {
        name: SERVER.into(),
        workers: options.workers,
        // Half of the places are reserved for peers that have none, and all of these clients are one peer.
        capacity: 2 * jobs.len().max(1),
        weights: options.weights.clone(),
        meshes: options.meshes.clone(),
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
        let lost = if lost.is_empty() { "it was stopped before one was over".into() } else { lost.join("\n  ") };
        return Err(EvaluateError::Nothing { lost });
    }
    let results = grade_bags(&recorded, &bags, options)?;
    lost.extend(results.excluded.iter().map(|bag| {
        // The client's reason says more than an aborted bag does.
        let job = jobs.iter().find(|job| bag.bag.ends_with(&job.bag_name()));
        format!("{}: {}", bag.bag, job.and_then(|job| played.reason(*job)).unwrap_or(&bag.detail))
    }));
    Ok(Outcome { results, resumed, lost, stopped: stop.load(Ordering::Relaxed) })
}

/// Episodes that an earlier call with other tasks or seeds left in the folder.
fn earlier(jobs: &[Job], bags: &Path) -> Result<Vec<Job>, EvaluateError> {
    let mut earlier = Vec::new();
    for entry in std::fs::read_dir(bags).map_err(|error| folder(bags, error))? {
        let path = entry.map_err(|error| folder(bags, error))?.path();
        if path.extension().is_none_or(|ending| ending != "mcap") {
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

/// Grades the bags of some jobs, with names relative to the output folder.
fn grade_bags(jobs: &[Job], bags: &Path, options: &EvaluateOptions) -> Result<Results, ScoreError> {
    let paths: Vec<PathBuf> = jobs.iter().map(|job| bags.join(job.bag_name())).collect();
    let grading =
        GradeOptions { workers: options.workers, relative_to: options.out.clone(), ..GradeOptions::default() };
    grade(&paths, &grading, &|_| {})
}

fn folder(path: &Path, problem: impl ToString) -> EvaluateError {
    EvaluateError::Folder { path: path.into(), problem: problem.to_string() }
}
