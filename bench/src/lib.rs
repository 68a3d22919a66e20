//! Benchmarks: how fast each part is, measured on the same work as its rival.

pub mod batch;
mod case;
mod machine;
mod mujoco;
#[cfg(feature = "rapier")]
mod multibody;
mod report;
mod room;
pub mod sensors;
pub mod service;
mod stats;
pub mod violence;
pub mod world;
mod worlds;

pub use case::{Case, cases};
pub use mujoco::{MujocoTime, Oracle};
#[cfg(feature = "rapier")]
pub use multibody::MultibodyWorld;
pub use report::{CaseReport, Report, RoomReport, WorldsReport};
pub use stats::Times;

/// Why a benchmark could not run.
#[derive(Debug, thiserror::Error)]
pub enum BenchError {
    /// The scene of the benchmark could not be built.
    #[error("benchmark scene")]
    Scene(#[source] Box<dyn std::error::Error + Send + Sync>),
    /// A start state could not be reached.
    #[error("case '{case}': {problem}")]
    Start {
        /// Name of the case.
        case: &'static str,
        /// The expected and the actual result.
        problem: String,
    },
    /// Rapier refused a joint.
    #[cfg(feature = "rapier")]
    #[error("Rapier took no multibody joint for body '{0}'; its tree has a loop or two parents")]
    Joint(String),
    /// Rapier refused a convex hull.
    #[cfg(feature = "rapier")]
    #[error("Rapier takes no convex hull of shape '{0}'; use a box or a capsule in the comparison")]
    Hull(String),
    /// The script that times MuJoCo or PyTorch does not exist.
    #[error(
        "no oracle script at '{0}'; run from the repository's root, name it with --oracle, or leave the comparison out"
    )]
    NoOracle(std::path::PathBuf),
    /// A file or program of a comparison failed.
    #[error(
        "comparison: could not {what}; it needs python3 (3.11 or newer) and write access to the temporary folder; \
             without them leave it out"
    )]
    Io {
        /// Verb and object for the message.
        what: String,
        /// The operating system's error.
        #[source]
        source: std::io::Error,
    },
    /// The script failed; it reported the reason on stderr.
    #[error(
        "comparison of '{case}' failed ({status}); its own message is above. On its first run it installs its \
             requirements (tests/oracle) and needs a package index; without one leave the comparison out"
    )]
    OracleFailed {
        /// Name of the case.
        case: &'static str,
        /// Exit status of the script.
        status: std::process::ExitStatus,
    },
    /// The script's output has another form.
    #[error("comparison of '{case}': unexpected output; is the oracle script of another version?")]
    OracleOutput {
        /// Name of the case.
        case: &'static str,
        /// The parser's error, with line and column.
        #[source]
        source: serde_json::Error,
    },
}
