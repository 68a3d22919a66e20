use fiatlux_dynamics::ModelError;
use fiatlux_robot::RobotError;
use fiatlux_rules::RobotLayout;
use thiserror::Error;

use crate::{ACTION_LIMIT, RangeError};

/// Why a scene cannot be built.
#[derive(Debug, Error)]
#[allow(missing_docs)] // The messages say it.
pub enum SceneError {
    #[error("scene config{}: {reason}", at_line(*.line))]
    Toml {
        /// Line of the fault, from 1, where known.
        line: Option<usize>,
        reason: String,
    },
    #[error("scene config{}: {field} is {value}; {rule}", at_line(*.line))]
    Value { field: &'static str, line: Option<usize>, value: String, rule: String },
    #[error("no room for seed {seed} after {redraws} draws: '{zone}' found no free place; make zones or gap smaller")]
    Layout { seed: u64, redraws: u32, zone: &'static str },
    #[error("prop scale: {factor} is {value}; it must be within {low} and {high}")]
    Scale { factor: &'static str, value: f64, low: f64, high: f64 },
    #[error("scene cannot be varied")]
    Varied(#[from] RangeError),
    #[error("recorded layout: {field} {rule}; use the layout as it was recorded, in a scene of the same kind")]
    Recorded { field: &'static str, rule: &'static str },
    #[error("scene cannot be modelled")]
    Model(#[from] ModelError),
    #[error("robot '{robot}' has {found} {part} where {needed} are needed; use a robot with {needed}")]
    RobotParts { robot: String, part: &'static str, found: usize, needed: usize },
    #[error(
        "robot '{robot}' has {right} sensed links in the right hand and {left} in the left; list as many of both in \
         hand_links, the right hand's first"
    )]
    Hands { robot: String, right: usize, left: usize },
    #[error("scene cannot take the robot")]
    Robot(#[source] RobotError),
}

/// Why a world cannot do what was requested; it is unchanged.
#[derive(Debug, Clone, PartialEq, Error)]
#[allow(missing_docs)] // The messages say it.
pub enum WorldError {
    #[error("{field} of joint '{joint}' is not finite; send finite numbers")]
    Joint { field: &'static str, joint: String },
    #[error("action of joint '{joint}' is {value:?}; send numbers from -{ACTION_LIMIT} to {ACTION_LIMIT}")]
    Action { joint: String, value: f64 },
    #[error("{field} has {found} numbers instead of {expected}; send one a joint")]
    Length { field: &'static str, found: usize, expected: usize },
    #[error("wrench {index} {problem}")]
    Wrench { index: usize, problem: &'static str },
    #[error("the push has a number that is not finite; give finite ones")]
    Push,
    #[error("cannot vary the world")]
    Variation(#[from] ModelError),
    #[error("row to start from: it has {found:?}, the scene's robot has {expected:?}; take a row of the same robot")]
    Layout { found: RobotLayout, expected: RobotLayout },
    #[error("row to start from: {field} is {value}; {rule}")]
    Row { field: &'static str, value: f64, rule: &'static str },
}

fn at_line(line: Option<usize>) -> String {
    line.map(|line| format!(" line {line}")).unwrap_or_default()
}
