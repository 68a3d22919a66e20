//! Benchmarks: how fast each part is, measured on the same work as its rival.
#![allow(missing_docs)] // Used in this repository alone.

pub mod batch;
pub mod camera;
mod case;
mod folder;
mod machine;
mod mujoco;
#[cfg(feature = "rapier")]
mod multibody;
mod report;
mod room;
pub mod sensors;
pub mod service;
pub mod shares;
mod stats;
pub mod violence;
pub mod world;
mod worlds;

pub use case::{Case, cases};
use folder::Folder;
pub use mujoco::{MujocoTime, Oracle};
#[cfg(feature = "rapier")]
pub use multibody::MultibodyWorld;
pub use report::{CaseReport, Report, RoomReport, WorldsReport};
pub use stats::Times;

/// Why a benchmark could not run.
#[derive(Debug, thiserror::Error)]
pub enum BenchError {
    #[error("benchmark scene")]
    Scene(#[source] Box<dyn std::error::Error + Send + Sync>),
    #[error("case '{case}': {problem}")]
    Start { case: &'static str, problem: String },
    #[cfg(feature = "rapier")]
    #[error("Rapier took no multibody joint for body '{0}'; its tree has a loop or two parents")]
    Joint(String),
    #[cfg(feature = "rapier")]
    #[error("Rapier takes no convex hull of shape '{0}'; use a box or a capsule in the comparison")]
    Hull(String),
    #[error(
        "no oracle script at '{0}'; run from the repository's root, name it with --oracle, or leave the comparison out"
    )]
    NoOracle(std::path::PathBuf),
    #[error(
        "comparison: could not {what}; it needs python3 (3.11 or newer) and write access to the temporary folder; \
             without them leave it out"
    )]
    Io {
        /// Verb and object for the message.
        what: String,
        source: std::io::Error,
    },
    #[error(
        "comparison of '{case}' failed ({status}); its own message is above. On its first run it installs its \
             requirements (tests/oracle) and needs a package index; without one leave the comparison out"
    )]
    OracleFailed { case: &'static str, status: std::process::ExitStatus },
    #[error("comparison of '{case}': unexpected output; is the oracle script of another version?")]
    OracleOutput { case: &'static str, source: serde_json::Error },
}
