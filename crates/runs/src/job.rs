//! Options of an evaluation, one episode of it, and its errors.

use std::path::{Path, PathBuf};

use fiatlux_bag::bag_name;
use fiatlux_client::{Policy, PolicyError, RunError, SessionArgs, Shard, ShardRecord, request_of};
use fiatlux_grading::{GradeOptions, Results, ScoreError};
use fiatlux_policies::Policies;
use fiatlux_proto::PROTOCOL;
use fiatlux_proto::v3::OpenRequest;
use fiatlux_rules::{ReservedSeed, Task};
use fiatlux_server::ServerError;
use fiatlux_world::SceneConfig;
use thiserror::Error;

/// Name of the server in this process.
pub(super) const SERVER: &str = "evaluate";

#[derive(Debug, Clone)]
pub struct EvaluateOptions {
    /// Policies that can be played.
    pub policies: Policies,
    /// Name of the one that is, such as `zero`.
    pub policy: String,
    /// Tasks to play, each once.
    pub tasks: Vec<Task>,
    /// Layout seeds, each once; one episode of each task is played in each.
    pub seeds: Vec<u64>,
    /// Folder for bags, results and report, which are of everything in it. Whole bags of the same evaluation and version are
    /// kept; what an earlier call with other tasks or seeds left there belongs to this one.
    pub out: PathBuf,
    /// Keep bags thin: without the rows, which are simulated again when they are read.
    pub thin: bool,
    /// Number of episodes to play at once.
    pub workers: usize,
    /// Folder of weights that a session may name.
    pub weights: Option<PathBuf>,
    /// Folder of meshes that replace the built-in shapes of the robot.
    pub meshes: Option<PathBuf>,
    /// Scene that the server simulates.
    pub scene: SceneConfig,
    /// The request for every session, without policy, task and seed.
    pub session: SessionArgs,
    /// The part of the episodes to play, and the command that plays another ([`ShardRecord::again`]); `None` for all of them.
    pub shard: Option<(Shard, String)>,
}

/// One episode to play.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Job {
    pub task: Task,
    pub seed: u64,
}

impl EvaluateOptions {
    /// The episodes to play; the record of a shard is in its folder from then on.
    pub(super) fn jobs(&self) -> Result<Vec<Job>, EvaluateError> {
        let all = self.tasks.iter().flat_map(|&task| self.seeds.iter().map(move |&seed| Job { task, seed }));
        let Some((shard, again)) = &self.shard else { return Ok(all.collect()) };
        let record = ShardRecord {
            shard: shard.to_string(),
            tasks: self.tasks.iter().map(Task::to_string).collect(),
            seeds: self.seeds.clone(),
            again: again.clone(),
        };
        record.keep(&self.out).map_err(|error| folder(&self.out, error))?;
        Ok(all.enumerate().filter(|(index, _)| shard.has(*index)).map(|(_, job)| job).collect())
    }

    pub(super) fn request(&self, job: Job, policy: &dyn Policy) -> OpenRequest {
        let mut request = OpenRequest {
            protocol: Some(PROTOCOL),
            task: job.task.to_string(),
            seed: job.seed,
            recorded: true,
            ..request_of(policy)
        };
        self.session.apply(&mut request);
        request
    }
}

impl Job {
    /// Name of the job's bag inside the folder.
    pub(super) fn bag_name(self) -> String {
        bag_name(self.task.short_id(), self.seed, 0)
    }

    /// The job whose bag has this name.
    pub(super) fn of_bag(name: &str) -> Option<Self> {
        let (task, seed) = name.split_once("-s")?;
        let job = Self { task: task.parse().ok()?, seed: seed.split_once('-')?.0.parse().ok()? };
        (job.bag_name() == name).then_some(job)
    }
}

/// Why an evaluation could not be carried out.
#[derive(Debug, Error)]
pub enum EvaluateError {
    #[error("cannot use the output folder {}: {problem}", path.display())]
    Folder { path: PathBuf, problem: String },
    /// The policy cannot be made.
    #[error(transparent)]
    Policy(#[from] PolicyError),
    #[error("cannot load the robot")]
    Robot(#[from] fiatlux_robot::RobotError),
    #[error("cannot use the meshes of the robot")]
    Meshes(#[from] fiatlux_render::MeshError),
    #[error("cannot start the server")]
    Server(#[from] ServerError),
    #[error("no episode was recorded:\n  {lost}")]
    Nothing { lost: String },
    #[error("{problem}")]
    Name { problem: String },
    #[error("stopped: 0 of {episodes} played; the rest will be played by the same command")]
    Stopped { episodes: usize },
    #[error("no episode was played to its end:\n  {lost}")]
    Unplayed { lost: String },
    /// The run cannot be played.
    #[error(transparent)]
    Run(#[from] RunError),
    #[error("cannot read the state of the run")]
    Ledger(#[from] fiatlux_bag::run::LedgerError),
    #[error("cannot grade the bags")]
    Score(#[from] ScoreError),
    /// Demonstrations would be played in a room that is not for training.
    #[error(transparent)]
    Seed(#[from] ReservedSeed),
}

pub(super) fn job_bags(jobs: &[Job], bags: &Path) -> Vec<PathBuf> {
    jobs.iter().map(|job| bags.join(job.bag_name())).collect()
}

/// Grades bags, with names relative to the output folder.
pub(super) fn grade(bags: &[PathBuf], workers: usize, out: &Path) -> Result<Results, ScoreError> {
    let options = GradeOptions { workers, relative_to: out.into(), ..GradeOptions::default() };
    fiatlux_grading::grade(bags, &options, &|_| {})
}

pub(super) fn folder(path: &Path, problem: impl ToString) -> EvaluateError {
    EvaluateError::Folder { path: path.into(), problem: problem.to_string() }
}
