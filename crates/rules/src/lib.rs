//! The rulebook: subtasks, gates, rewards, weights and scores as pure functions of recorded state.
//!
//! A [`Judge`] folds the [`Row`]s of an episode into a [`Verdict`]; the same code ends an episode online and grades it
//! offline. [`Rewards`] pays for the same rows, term by term. [`Benchmark`] rolls [`Episode`]s up into scores.
//!
//! Nothing here reads a file, a clock or a simulator. Figures that rules compare with are data: [`Thresholds`] and
//! [`Geometry`].
/// Version of the benchmark: of its rooms, its physics and its rules. Scores of different versions never share a ranking.
pub const BENCHMARK_VERSION: u32 = 1;

mod cause;
mod digest;
mod gate;
mod geometry;
mod judge;
pub mod measure;
pub mod predicates;
mod rewards;
mod row;
mod scores;
mod settle;
mod task;
mod tasks;
mod thresholds;

pub use cause::{Cause, Causes, UnknownCause};
pub use digest::{ROW_LAYOUT, RowDigest};
pub use gate::{Context, Criteria, Criterion, Gate, MAX_CRITERIA, Predicate};
pub use geometry::{BulbGeometry, Geometry};
pub use judge::{End, Judge, JudgeOptions, Verdict};
pub use rewards::{ANKLE_LIMITS, Rewards, Term, Variant};
pub use row::{AttachmentRow, BodyRow, Bulb, LIMBS, Limb, RobotLayout, Row};
pub use scores::{Benchmark, Episode, Rate, SeedScore, Spread, SubtaskScore, Summary, wilson_interval};
pub use settle::PoseSpeed;
pub use task::{CONTROL_DT, ControlMode, Factor, GRAVITY, Task, TaskSpec, UnknownTask};
pub use thresholds::{ThresholdError, Thresholds};
