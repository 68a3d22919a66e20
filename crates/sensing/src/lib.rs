//! The robot's senses, as a registry of sensors: each one is a file in `sensors/` with its name, its terms, its needs, the code
//! that computes its numbers and their place in a message. Nothing is computed that nobody asks for, and nothing twice in a
//! row. Noise is drawn by step: the noise of observation k is the same whatever was asked for before.
//!
//! ```
//! use std::sync::Arc;
//! use fiatlux_render::{Lighting, Visuals};
//! use fiatlux_robot::{GainSet, Robot};
//! use fiatlux_rules::Task;
//! use fiatlux_sensing::{NoiseSeed, Sensor, SensorSuite, Sensors, Setup, View};
//! use fiatlux_world::{Episode, EpisodeSpec, Scene, SceneConfig};
//!
//! let robot = Arc::new(Robot::benchmark()?);
//! let spec = EpisodeSpec::new(Task::S07, 3, 0);
//! let scene = Scene::build(&SceneConfig::default(), Arc::clone(&robot), spec.scene(robot.gains(GainSet::default())))?;
//! let episode = Episode::start(Arc::new(scene), &spec)?;
//!
//! let sensors = Sensors::of_body(Task::S07).with(Sensor::Lidar);
//! let mut suite = SensorSuite::new(sensors, Setup::new(episode.scene(), Task::S07));
//! let visuals = || Arc::new(Visuals::new(episode.scene()));
//! suite.begin(episode.scene(), NoiseSeed::of(episode.spec()), visuals, Lighting::default())?;
//!
//! // Into a buffer of the caller's ...
//! let mut ranges = vec![0.0; suite.length(Sensor::Lidar)];
//! suite.compute(Sensor::Lidar, &View::of(&episode), &mut ranges)?;
//! assert!(ranges.iter().all(|range| (0.0..=10.0).contains(range)));
//! // ... or as a message.
//! let observation = suite.observe(&View::of(&episode), sensors)?;
//! assert_eq!(observation.lidar, ranges);
//! assert_eq!(observation.last_action.len(), robot.joints().len());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
mod devices;
mod foot_force;
mod kinematics;
mod lidar;
mod message;
mod noise;
mod observer;
mod out;
mod registry;
mod sampler;
mod sensor;
mod sensors;
mod set;
mod suite;
mod view;

pub use devices::SenseError;
pub use fiatlux_proto::Proprioception;
pub use foot_force::{FOOT_FORCE_HEIGHT, foot_force_estimate};
pub use kinematics::world_from_link;
pub use lidar::{LIDAR_COLUMNS, LIDAR_RANGE, LIDAR_RAYS, LIDAR_ROWS, Lidar, Sight};
pub use message::{camera_messages, segment_names, term_messages};
pub use noise::NoiseSeed;
pub use observer::Observer;
pub use registry::Sensor;
pub use sampler::{Cadence, NotSampled, Sampler, TakenError};
pub use sensor::{Class, Cost, Setup, Term};
pub use sensors::{ClimbPrivileged, Privileged, hand_force, limb_force};
pub use set::Sensors;
pub use suite::SensorSuite;
pub use view::View;
