//! The benchmark's scene as data and as a model of the dynamics engine: room, bench, crate, fixture, bulbs, ladder and
//! robot, their draw by seed, the socket's hold on a bulb, the tasks' start states, and episodes.
mod attach;
pub mod config;
mod domain_sample;
mod episode;
mod error;
mod footprint;
mod input;
mod layout;
mod owner;
mod parts;
mod props;
mod randomize;
mod rng;
mod scene;
mod start;
mod world;

pub use attach::{Attachment, AttachmentState, PlugState, hold_wrench};
pub use config::SceneConfig;
pub use domain_sample::DomainSample;
pub use episode::{Episode, EpisodeError, EpisodeSpec, Step, Totals};
pub use error::{SceneError, WorldError};
pub use footprint::Footprint;
pub use input::{AppliedWrench, ControlInput, Push, Target};
pub use layout::{LadderStart, Layout, Mount, Place};
pub use owner::ShapeOwner;
pub use parts::{FAR, LadderPart, SceneKind, SceneParts};
pub use props::{LadderPoints, PropSizes};
pub use randomize::{HandFriction, Light, PropScale, Randomization};
pub use rng::{RNG_NAME, Random, Stream};
pub use scene::{Scene, SceneSpec};
pub use start::{ACTION_SCALE, StartError, StartOffset, StartOptions, start, start_drawn};
pub use world::{PHYSICS_DT, SUBSTEPS, World};

// The rulebook's control step and gravity are the world's.
const _: () = assert!(PHYSICS_DT * SUBSTEPS as f64 == fiatlux_rules::CONTROL_DT);
const _: () = assert!(fiatlux_dynamics::STANDARD_GRAVITY == fiatlux_rules::GRAVITY);
