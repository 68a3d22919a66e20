//! The benchmark's scene as data and as a model of the dynamics engine: room, bench, crate, fixture, bulbs, ladder and
//! robot, their draw by seed, the socket's hold on a bulb, the tasks' start states, and episodes.
//!
//! A [`Scene`] is built once and shared; a [`World`] is a scene in motion, measured as rows; an [`Episode`] joins a world with
//! a task's start, judge and digest.
//!
//! ```
//! use std::sync::Arc;
//! use fiatlux_robot::{GainSet, Robot};
//! use fiatlux_world::{ControlInput, Push, Scene, SceneConfig, SceneSpec, World};
//! use nalgebra::Vector3;
//!
//! // A robot on a floor; the tasks' scenes come from `EpisodeSpec::scene`.
//! let robot = Arc::new(Robot::by_name("g1_bare")?);
//! let spec = SceneSpec::floor(robot.gains(GainSet::default()));
//! let scene = Arc::new(Scene::build(&SceneConfig::default(), Arc::clone(&robot), spec)?);
//!
//! let mut world = World::new(scene);
//! let start = world.row().clone();
//! let action = vec![0.0; robot.joints().len()];
//! world.step(&action, robot.q0())?;
//!
//! // From any row a world goes on as the one that measured it.
//! world.reset_to(&start)?;
//! let push = Some(Push { linear: Vector3::new(0.3, 0.0, 0.0), angular: Vector3::zeros() });
//! let row = world.step_with(&ControlInput { push, ..ControlInput::new(&action, robot.q0()) })?;
//! assert!(row.step == 1 && row.com_velocity.x > 0.1);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
mod action;
mod attach;
pub mod config;
mod delay;
mod domain_sample;
mod episode;
mod error;
mod footprint;
mod input;
mod layout;
mod object;
mod owner;
mod parts;
mod props;
mod randomize;
mod rng;
mod scene;
mod silhouette;
mod sites;
mod start;
mod world;

pub use action::{ACTION_LIMIT, ACTION_SCALE};
pub use attach::{Attachment, AttachmentState, PlugState, hold_wrench};
pub use config::SceneConfig;
pub use delay::Delay;
pub use domain_sample::DomainSample;
pub use episode::{Episode, EpisodeError, EpisodeSpec, Step, Totals};
pub use error::{SceneError, WorldError};
pub use footprint::Footprint;
pub use input::{AppliedWrench, ControlInput, Push, Target};
pub use layout::{LadderStart, Layout, Mount, Place};
pub use object::{ASSET_PLACES, AssetArg, BulbShape, JointKind, Link, LinkJoint, Object, ObjectError, Role};
pub use owner::ShapeOwner;
pub use parts::{LadderPart, SceneKind, SceneParts};
pub use props::{LadderPoints, Part, PropSizes};
pub use randomize::{
    CameraVariation, EpisodeRanges, HandFriction, Light, PropScale, Randomization, RangeError, Varied, camera_ranges,
    delay_steps, free_things, noise_scale, surfaces,
};
pub use rng::{GENERATORS, RNG_NAME, Random, Stream};
pub use scene::{Placed, Scene, SceneSpec};
pub use start::{StartError, StartOffset, StartOptions, start, start_drawn};
pub use world::{PHYSICS_DT, SUBSTEPS, World};

// The rulebook's control step and gravity are the world's.
const _: () = assert!(PHYSICS_DT * SUBSTEPS as f64 == fiatlux_rules::CONTROL_DT);
const _: () = assert!(fiatlux_dynamics::DEFAULT_GRAVITY == fiatlux_rules::GRAVITY);
