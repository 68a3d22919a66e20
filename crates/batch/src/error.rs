use fiatlux_rules::RobotLayout;
use fiatlux_world::{SceneError, StartError, WorldError};
use thiserror::Error;

/// Why a task cannot continue.
pub type TaskError = Box<dyn std::error::Error + Send + Sync>;

/// Why a bank has no starts.
#[derive(Debug, Error)]
pub enum BankError {
    /// A scene of an episode could not be built.
    #[error("{task} seed {seed}: the scene cannot be built")]
    Scene {
        /// The task whose scene it is.
        task: fiatlux_rules::Task,
        /// The benchmark's seed of the room.
        seed: u64,
        /// The scene builder's error.
        #[source]
        source: SceneError,
    },
    /// An episode has no start.
    #[error(transparent)]
    Start(#[from] StartError),
}

/// Why a batch cannot do what was requested.
#[derive(Debug, Error)]
pub enum BatchError {
    /// A number of the config is out of range.
    #[error("batch config: {field} is {found}; {rule}")]
    Config {
        /// The field of the config, such as `worlds`.
        field: &'static str,
        /// The value that it has.
        found: usize,
        /// The rule that it breaks.
        rule: String,
    },
    /// The system has no memory for the buffers of so many worlds.
    #[error(
        "worlds: no memory for {worlds} worlds with observations of {numbers} numbers; use fewer worlds or smaller images"
    )]
    Memory {
        /// Number of worlds.
        worlds: usize,
        /// Numbers of an observation.
        numbers: usize,
    },
    /// A disturbance is not valid.
    #[error("disturbances: {field} {rule}")]
    Disturbance {
        /// The field of the config, such as `worlds`.
        field: &'static str,
        /// The rule that it breaks.
        rule: &'static str,
    },
    /// A range from which worlds are drawn is not valid.
    #[error("ranges: {field} {rule}")]
    Range {
        /// The field of [`Ranges`](crate::Ranges), such as `mass`.
        field: &'static str,
        /// The rule that it breaks.
        rule: &'static str,
    },
    /// The banks have robots of different sizes.
    #[error("bank {bank} has a robot of {found:?}, bank 0 one of {expected:?}; give all banks the same robot")]
    Robots {
        /// Index of the bank.
        bank: usize,
        /// Sizes of that bank's robot.
        found: RobotLayout,
        /// Those of bank 0.
        expected: RobotLayout,
    },
    /// No world can start from a start of a bank.
    #[error("bank {bank}, start {start}: no world starts there")]
    Start {
        /// Index of the bank.
        bank: usize,
        /// Index of the start in the bank.
        start: usize,
        /// The world's error, which says why.
        #[source]
        source: WorldError,
    },
    /// No start can be drawn from a bank.
    #[error("bank {bank}: the weights of starts must be finite and at least 0, and one of them above 0")]
    Weights {
        /// Index of the bank.
        bank: usize,
    },
    /// The system refused to start a thread.
    #[error("cannot start a thread; use fewer threads")]
    Thread(#[source] std::io::Error),
    /// A buffer has the wrong length.
    #[error("{field} has {found} numbers instead of {expected}")]
    Length {
        /// The buffer, such as `actions`.
        field: &'static str,
        /// The length that it has.
        found: usize,
        /// The length that it must have.
        expected: usize,
    },
    /// A number of an action is not finite or too large. No world was stepped.
    #[error("actions: world {world}, '{name}' is {value}; send numbers from -{limit} to {limit}")]
    Action {
        /// Index of the world in the batch.
        world: usize,
        /// Name of the number.
        name: String,
        /// The value that was sent.
        value: f64,
        /// Largest allowed absolute value.
        limit: f64,
    },
    /// The batch has fewer worlds.
    #[error("world {world} does not exist; the batch has {worlds}")]
    NoWorld {
        /// The index asked for.
        world: usize,
        /// Worlds of the batch.
        worlds: usize,
    },
    /// A world refused a row, or the task's command.
    #[error("world {world} refuses its input")]
    World {
        /// Index of the world in the batch.
        world: usize,
        /// The world's error, which says why.
        #[source]
        source: WorldError,
    },
    /// The task of a world returned an error.
    #[error("world {world}: the task cannot go on")]
    Task {
        /// Index of the world in the batch.
        world: usize,
        /// The task's own reason.
        #[source]
        source: TaskError,
    },
    /// The task panicked; its own message is on stderr.
    #[error("world {world}: the task panicked")]
    Panicked {
        /// Index of the world in the batch.
        world: usize,
    },
    /// The caller broke off the step after some worlds had taken it.
    #[error("the step was broken off; reset the batch or restore a snapshot")]
    Stopped,
    /// An earlier call failed, and left some worlds a step ahead of others.
    #[error("an earlier call ended in the middle of a step; reset the batch or restore a snapshot")]
    Torn,
    /// The episode of a world has ended, and nothing begins the next one.
    #[error("the episode of world {world} has ended; reset that world before the next step")]
    Ended {
        /// Index of the first such world.
        world: usize,
    },
    /// A snapshot belongs to another batch.
    #[error(
        "snapshot: {field} is {found}, but the batch has {expected}; restore it into a batch with the same settings"
    )]
    Snapshot {
        /// The setting that differs.
        field: String,
        /// Its value in the snapshot.
        found: String,
        /// Its value in the batch.
        expected: String,
    },
    /// Bytes are not those of a snapshot.
    #[error("the snapshot is damaged: {reason}")]
    Damaged {
        /// Fault of the value.
        reason: String,
    },
    /// The process is a forked child of the one that made the batch, and so has none of its threads.
    #[error(
        "the batch was made in process {parent}, whose threads a forked child lacks; make the batch in the child, or start \
         processes with `spawn`"
    )]
    Forked {
        /// Id of the process that made the batch.
        parent: u32,
    },
}
