//! Many worlds in step, for learners.
//!
//! A [`Batch`] holds N worlds and steps them all in one call, on T threads, into buffers that the caller owns. Worlds start
//! from the rows of a [`Bank`], and start again when their episode ends, as [`Autoreset`] says. A [`Task`] says what actions
//! mean, what is observed, what is paid and what ends an episode: [`Rulebook`] plays the benchmark's tasks, [`Walking`] is an
//! example of a task outside the rulebook.
//!
//! Results follow only from config and actions: they depend neither on the number of threads nor on the other worlds in
//! the batch. Each world has its own random stream, given by the batch's seed and the world's index. A step allocates
//! nothing but the last observation of an episode with pictures.
//!
//! ```
//! use std::sync::Arc;
//! use fiatlux_batch::{Bank, Batch, BatchConfig, Outputs, Ranges, Walking};
//! use fiatlux_robot::{GainSet, Robot};
//! use fiatlux_world::{Scene, SceneConfig, SceneSpec};
//!
//! // A robot on a floor. Its friction and masses vary from world to world.
//! let robot = Arc::new(Robot::by_name("g1_bare")?);
//! let spec = SceneSpec::floor(robot.gains(GainSet::default()));
//! let scene = Arc::new(Scene::build(&SceneConfig::default(), robot, spec)?);
//! let ranges = Ranges { floor_friction: Some([0.5, 1.1]), mass: [0.95, 1.05], ..Ranges::NOMINAL };
//! let bank = Bank::standing(scene).varied(&ranges, 8, 0);
//!
//! let task = Walking::new(&bank.scene, Default::default())?;
//! let mut batch = Batch::new(BatchConfig { worlds: 4, threads: 2, ..BatchConfig::new(vec![bank]) }, &task)?;
//! let mut outputs = Outputs::new(&batch);
//! batch.reset(&mut outputs.observation)?;
//! let actions = vec![0.0; batch.worlds() * batch.spec().actions.len()];
//! for _ in 0..10 {
//!     batch.step(&actions, &mut outputs.buffers())?;
//! }
//! assert!(outputs.observation.iter().all(|number| number.is_finite()));
//! # Ok::<(), Box<dyn std::error::Error + Send + Sync>>(())
//! ```
mod bank;
mod batch;
mod buffers;
mod climbing;
mod config;
mod disturbance;
mod error;
mod job;
mod possible;
mod ranges;
mod rulebook;
mod slot;
mod snapshot;
mod task;
mod walking;
mod watch;
mod workers;

pub use bank::{Bank, Start};
pub use batch::Batch;
pub use buffers::{Buffers, Outputs};
pub use climbing::{Climbing, ClimbingOptions};
pub use config::{Autoreset, BatchConfig, MAX_STARTS, MAX_THREADS, MAX_WORLDS};
pub use disturbance::{Disturbances, Pushes, Wrenches};
pub use error::{BankError, BatchError, TaskError};
pub use job::Begin;
pub use ranges::{Drawn, Ranges};
pub use rulebook::{ActionForm, Rulebook, RulebookOptions};
pub use snapshot::Snapshot;
pub use task::{Control, Field, Outcome, Spec, Task, TaskClone, Verdicts};
pub use walking::{Walking, WalkingOptions};
pub use watch::Watch;
