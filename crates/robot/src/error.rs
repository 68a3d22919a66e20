use fiatlux_dynamics::ModelError;
use thiserror::Error;

use crate::names::NAMES;

/// Why a robot file or a request about a robot was refused.
#[derive(Debug, Clone, PartialEq, Error)]
#[allow(missing_docs)] // The messages say it.
pub enum RobotError {
    #[error("line {line}: {problem}")]
    Syntax { line: usize, problem: String },
    #[error("line {line}: {part} '{name}': {field} {problem}")]
    Value { line: usize, part: &'static str, name: String, field: &'static str, problem: String },
    #[error("robot '{0}' is unknown; use one of {known}", known = NAMES.map(|name| format!("'{name}'")).join(", "))]
    Name(String),
    #[error("no known robot has these {found} joints in this order; the known ones are {known}", known = NAMES.join(", "))]
    Joints { found: usize },
    #[error(
        "the {found} joints are not those of robot '{name}', which has {expected}, or in another order; name the robot that has them"
    )]
    OtherJoints { name: String, expected: usize, found: usize },
    #[error("gain set '{0}' is unknown; use 'fiatlux', 'sonic', 'gear' or 'gear-lerobot'")]
    GainSet(String),
    #[error("gains are for {found} joints, the robot has {expected}; start from Robot::gains")]
    Gains { expected: usize, found: usize },
    #[error("body {0} of the robot is not in this model; use the model built from the robot's builder")]
    OtherModel(usize),
    /// The dynamics engine refused a body, a shape or an array.
    #[error(transparent)]
    Engine(#[from] ModelError),
}
