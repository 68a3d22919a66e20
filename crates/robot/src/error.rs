use fiatlux_dynamics::ModelError;
use thiserror::Error;

use crate::names::NAMES;

/// Why a robot file or a request about a robot was refused.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum RobotError {
    /// The file is not TOML, or a field is missing, unknown or of the wrong type.
    #[error("line {line}: {problem}")]
    Syntax {
        /// Line in the file, from 1.
        line: usize,
        /// The parser's message.
        problem: String,
    },
    /// A value of the file makes no sense.
    #[error("line {line}: {part} '{name}': {field} {problem}")]
    Value {
        /// Line in the file, from 1.
        line: usize,
        /// Kind of the part, such as `joint`.
        part: &'static str,
        /// Name of the part.
        name: String,
        /// Name of the field at fault, such as `mass`.
        field: &'static str,
        /// Fault and remedy.
        problem: String,
    },
    /// A robot that does not exist.
    #[error("robot '{0}' is unknown; use one of {known}", known = NAMES.map(|name| format!("'{name}'")).join(", "))]
    Name(String),
    /// Joints that belong to none of the known robots.
    #[error("no known robot has these {found} joints in this order; the known ones are {known}", known = NAMES.join(", "))]
    Joints {
        /// Number of joints that were named.
        found: usize,
    },
    /// A gain set that does not exist.
    #[error("gain set '{0}' is unknown; use 'fiatlux', 'sonic', 'gear' or 'gear-lerobot'")]
    GainSet(String),
    /// The gains handed over were made for another robot.
    #[error("gains are for {found} joints, the robot has {expected}; start from Robot::gains")]
    Gains {
        /// Joints of the robot.
        expected: usize,
        /// Number of joints that the gains are for.
        found: usize,
    },
    /// The model was not built from the builder that the robot was added to.
    #[error("body {0} of the robot is not in this model; use the model built from the robot's builder")]
    OtherModel(usize),
    /// The dynamics engine refused a body, a shape or an array.
    #[error(transparent)]
    Engine(#[from] ModelError),
}
