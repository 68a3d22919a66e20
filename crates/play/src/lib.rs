//! One episode as its robot lives it: a command arrives, is delayed or followed by the whole-body controller, acts, and the
//! sensors say what came of it. Sessions, environments, benchmarks and examples play with it, and so alike to the last bit.
//!
//! ```
//! use std::sync::Arc;
//! use fiatlux_play::{Command, Play};
//! use fiatlux_robot::{GainSet, Robot};
//! use fiatlux_rules::Task;
//! use fiatlux_sensing::{SensorSuite, Sensors, Setup};
//! use fiatlux_world::{Episode, EpisodeSpec, Scene, SceneConfig};
//!
//! let robot = Arc::new(Robot::benchmark()?);
//! let spec = EpisodeSpec::new(Task::S05, 3, 0);
//! let scene = Arc::new(Scene::build(&SceneConfig::default(), Arc::clone(&robot), spec.scene(robot.gains(GainSet::default())))?);
//! let episode = Episode::start(Arc::clone(&scene), &spec)?;
//!
//! let sensors = Sensors::of_body(Task::S05);
//! let suite = SensorSuite::new(sensors, Setup::new(&scene, Task::S05));
//! let mut play = Play::start(episode, suite, 1)?;
//! let held = play.episode().row().action.clone();
//! play.step(&Command::JointTarget(robot.q0().to_vec()))?;
//! assert_eq!(play.episode().row().action, held, "the command of the first step acts in the second");
//! play.step(&Command::JointTarget(robot.q0().to_vec()))?;
//! assert_eq!(play.episode().row().action, vec![0.0; held.len()]);
//! assert_eq!(play.observe(sensors)?.step, 2);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
mod play;
mod whole_body;

pub use fiatlux_session::Command;
pub use play::{Play, PlayError, Received};
pub use whole_body::whole_body_range;
