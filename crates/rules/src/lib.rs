//! The rulebook of the errand: subtasks, their criteria, rewards and weights as pure functions of recorded state.
//!
//! It measures rows and says what they show; `fiatlux-judge`, which knows no task, makes verdicts and scores of that. A [`Judge`] folds the [`Row`]s of an episode into a [`Verdict`] by one [`Protocol`]; [`Judges`] are both over the same
//! rows. The same code ends an episode online and grades it offline. [`Rewards`] pays for the same rows, term by term.
//! [`Benchmark`] rolls [`Episode`]s up into scores.
//!
//! ```
//! # use fiatlux_rules::{BulbGeometry, Geometry};
//! use fiatlux_rules::{Cause, Judge, JudgeOptions, Protocol, RobotLayout, Row, Task, Thresholds, errand};
//!
//! # let bulb = BulbGeometry { plug_z: 0.036, outline: vec![[0.036, 0.008], [0.193, 0.0]] };
//! # let geometry = Geometry {
//! #     ladder_top: [0.0, 0.1, 1.18],
//! #     ladder_feet: [[0.0; 3]; 4],
//! #     seat_z: 0.036,
//! #     bulbs: [bulb.clone(), bulb],
//! #     crate_outer_half: [0.3, 0.2],
//! #     crate_interior_half: [0.29, 0.19],
//! #     crate_rim: 0.17,
//! #     crate_floor: 0.004,
//! #     bench_surface: 0.9941,
//! #     robot_mass: 35.0,
//! # };
//! // The geometry is a scene's; rows come from a world or a bag.
//! let mut judge = Judge::new(Protocol::Published, Task::S07, Thresholds::default(), geometry, JudgeOptions::default());
//! let mut row = Row::zeros(RobotLayout { joints: 29, hand_bodies_per_side: 0 });
//! row.robot.pose.translation.z = 0.79;
//! row.things[errand::FRESH_BULB].pose.translation.x = 2.0;
//! // Facing the bulb and standing still, but not near it: two criteria of three.
//! assert_eq!(judge.start(&row).count, 2);
//!
//! row.step = 1;
//! row.robot.pose.translation.z = 0.3;
//! let end = judge.advance(&row).end.expect("the robot fell");
//! assert_eq!((end.step, end.cause()), (1, Cause::Fall));
//! assert_eq!(judge.summary().gate_progress, 0.0);
//! ```
//!
//! Nothing here reads a file, a clock or a simulator. Figures that rules compare with are data: [`Thresholds`] and
//! [`Geometry`].
/// Version of the benchmark: of its rooms, its physics and its rules. Scores of different versions never share a ranking.
pub const BENCHMARK_VERSION: u32 = 6;

mod bulb_motion;
mod context;
mod digest;
mod divergence;
pub mod errand;
mod evidence;
mod geometry;
mod identity;
mod judge;
mod judges;
mod manifest;
pub mod measure;
mod parts;
pub mod pins;
pub mod predicates;
mod presets;
mod relay;
mod rewards;
mod row;
mod seeds;
mod settle;
mod spec;
pub mod strict;
mod task;
mod tasks;
mod terms;
mod thresholds;

pub use context::{Context, Criterion, Gate, Predicate};
pub use digest::RowDigest;
pub use divergence::diverged;
pub use errand::manifest;
pub use fiatlux_judge::{
    Cause, Causes, Criteria, End, MAX_CRITERIA, Protocol, Rate, Spread, UnknownCause, UnknownProtocol, Verdict,
    wilson_interval,
};
pub use geometry::{BulbGeometry, Geometry};
pub use identity::{ACTION_DELAY, CAMERA, EpisodeIdentity, JointDrive, NOISE, of_scene};
pub use judge::{Judge, JudgeOptions};
pub use judges::{Judges, JudgesState};
pub use manifest::{Contact, Group, Manifest, ManifestError, Measure, Motion, Partner, Thing};
pub use measure::GRAVITY;
pub use parts::{AttachmentRow, BodyRow, Bulb, JointGroups, LIMBS, Limb, RobotLayout, Support};
pub use presets::{NamedRange, PRESETS, preset};
pub use relay::{Guest, NotAGuest, Relay};
pub use rewards::{Rewards, RewardsState, Variant};
pub use row::{By, CONTROL_DT, Field, Row};
pub use seeds::{ReservedSeed, SeedOwner};
pub use settle::PoseSpeed;
pub use spec::{
    ControlMode, Factor, Ladder, Landmark, ResetNoise, SpecialRules, Spot, Stand, StartDistance, StartSpec, TaskSpec,
};
pub use task::{Benchmark, Episode, SeedScore, SubtaskScore, Summary, Task, UnknownTask};
pub use terms::term::Term;
pub use thresholds::{ThresholdError, Thresholds};
