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
mod spec;
mod task;
mod tasks;
mod terms;
mod thresholds;
mod verdict;

pub use cause::{Cause, Causes, UnknownCause};
pub use digest::{ROW_LAYOUT, RowDigest};
pub use gate::{Context, Criteria, Criterion, Gate, MAX_CRITERIA, Predicate};
pub use geometry::{BulbGeometry, Geometry};
pub use judge::{Judge, JudgeOptions};
pub use measure::GRAVITY;
pub use rewards::{Rewards, Variant};
pub use row::{AttachmentRow, BodyRow, Bulb, CONTROL_DT, LIMBS, Limb, RobotLayout, Row};
pub use scores::{Benchmark, Episode, Rate, SeedScore, Spread, SubtaskScore, Summary, wilson_interval};
pub use settle::PoseSpeed;
pub use spec::{
    ControlMode, Factor, Ladder, Landmark, ResetNoise, SpecialRules, Spot, Stand, StartDistance, StartSpec, TaskSpec,
};
pub use task::{Task, UnknownTask};
pub use terms::motion::ANKLE_LIMITS;
pub use terms::term::Term;
pub use thresholds::{ThresholdError, Thresholds};
pub use verdict::{End, Verdict};
