use fiatlux_rules::RobotLayout;
use fiatlux_world::{SceneError, StartError, WorldError};
use thiserror::Error;

/// Why a task cannot continue.
pub type TaskError = Box<dyn std::error::Error + Send + Sync>;

/// Why a bank has no starts.
#[derive(Debug, Error)]
#[allow(missing_docs)] // The messages say it.
pub enum BankError {
    #[error("{task} seed {seed}: the scene cannot be built")]
    Scene { task: fiatlux_rules::Task, seed: u64, source: SceneError },
    /// An episode has no start.
    #[error(transparent)]
    Start(#[from] StartError),
}

/// Why a batch cannot do what was requested.
#[derive(Debug, Error)]
#[allow(missing_docs)] // The messages say it.
pub enum BatchError {
    #[error("batch config: {field} is {found}; {rule}")]
    Config { field: &'static str, found: usize, rule: String },
    #[error(
        "worlds: no memory for {worlds} worlds with observations of {numbers} numbers; use fewer worlds or smaller images, or \
         raise the limit of memory"
    )]
    Memory { worlds: usize, numbers: usize },
    #[error("disturbances: {field} {rule}")]
    Disturbance { field: &'static str, rule: &'static str },
    #[error("ranges: {field} {rule}")]
    Range {
        /// The field of [`Ranges`](crate::Ranges), such as `mass`.
        field: &'static str,
        rule: &'static str,
    },
    #[error("bank {bank} has a robot of {found:?}, bank 0 one of {expected:?}; give all banks the same robot")]
    Robots { bank: usize, found: RobotLayout, expected: RobotLayout },
    #[error("bank {bank}, start {start}: no world starts there")]
    Start { bank: usize, start: usize, source: WorldError },
    #[error("links: the scene has no site or link '{name}'; `Kinematics.sites` lists them")]
    Link { name: String },
    #[error("bank {bank}: the weights of starts must be finite and at least 0, and one of them above 0")]
    Weights { bank: usize },
    #[error("cannot start a thread; use fewer threads")]
    Thread(#[source] std::io::Error),
    #[error("{field} has {found} numbers instead of {expected}")]
    Length { field: &'static str, found: usize, expected: usize },
    /// A number of an action is not finite or too large. No world was stepped.
    #[error("actions: world {world}, '{name}' is {value:?}; send numbers from -{limit} to {limit}")]
    Action { world: usize, name: String, value: f64, limit: f64 },
    #[error("world {world} does not exist; the batch has {worlds}")]
    NoWorld { world: usize, worlds: usize },
    /// A row to begin at that no episode reaches. Nothing has changed.
    #[error("world {world} cannot begin there: {problem}")]
    Row { world: usize, problem: String },
    #[error("bank {bank}, start {start}: no world starts there: {problem}")]
    StartRow { bank: usize, start: usize, problem: String },
    #[error("world {world} refuses its input")]
    World { world: usize, source: WorldError },
    #[error("world {world}: the task cannot go on")]
    Task { world: usize, source: TaskError },
    #[error("world {world}: the task panicked")]
    Panicked { world: usize },
    /// The memory ran out before all worlds were done.
    #[error("the batch stopped before all worlds were done")]
    Stopped,
    /// A task failed in a step, which left some worlds a step ahead of others.
    #[error("an earlier step failed in the middle; reset the batch or restore a snapshot")]
    Torn,
    #[error("the episode of world {world} has ended; reset that world before the next step")]
    Ended { world: usize },
    #[error(
        "snapshot: {field} is {found}, but the batch has {expected}; restore it into a batch with the same settings"
    )]
    Snapshot { field: String, found: String, expected: String },
    #[error("the snapshot is damaged: {reason}")]
    Damaged { reason: String },
    #[error(
        "the batch was made in process {parent}, whose threads a forked child lacks; make the batch in the child, or start \
         processes with `spawn`"
    )]
    Forked { parent: u32 },
}
