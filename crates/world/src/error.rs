use fiatlux_dynamics::ModelError;
use fiatlux_robot::RobotError;
use fiatlux_rules::RobotLayout;
use thiserror::Error;

use crate::ACTION_LIMIT;

/// Why a scene cannot be built.
#[derive(Debug, Error)]
pub enum SceneError {
    /// The text is not TOML, or a field is unknown or of the wrong type.
    #[error("scene config{}: {reason}", at_line(*.line))]
    Toml {
        /// Line of the fault, from 1, where known.
        line: Option<usize>,
        /// Fault of the text.
        reason: String,
    },
    /// A field has an invalid value.
    #[error("scene config{}: {field} is {value}; {rule}", at_line(*.line))]
    Value {
        /// The field, such as `bench.surface_height`.
        field: &'static str,
        /// Its line, from 1, where the config's text gives it.
        line: Option<usize>,
        /// The value that was found.
        value: String,
        /// The rule that it breaks.
        rule: String,
    },
    /// The zones do not fit into the room.
    #[error("no room for seed {seed} after {redraws} draws: '{zone}' found no free place; make zones or gap smaller")]
    Layout {
        /// The layout seed that the room was drawn from.
        seed: u64,
        /// Number of rooms that were drawn.
        redraws: u32,
        /// The zone that found no place in the last draw.
        zone: &'static str,
    },
    /// A prop's size is out of its range.
    #[error("prop scale: {factor} is {value}; it must be within {low} and {high}")]
    Scale {
        /// The factor, such as `ladder_z`.
        factor: &'static str,
        /// The value that was given.
        value: f64,
        /// Smallest factor that is accepted.
        low: f64,
        /// Largest factor that is accepted.
        high: f64,
    },
    /// A recorded layout does not fit this scene.
    #[error("recorded layout: {field} {rule}; use the layout as it was recorded, in a scene of the same kind")]
    Recorded {
        /// The part at fault.
        field: &'static str,
        /// The rule that it breaks.
        rule: &'static str,
    },
    /// The engine refused a part of the scene.
    #[error("scene cannot be modelled")]
    Model(#[from] ModelError),
    /// The robot is not one that a row of the benchmark can hold.
    #[error("robot '{robot}' has {found} {part}, a row of the benchmark holds {needed}; use a robot with {needed}")]
    RobotParts {
        /// Name of the robot.
        robot: String,
        /// Items that are counted, such as `joints`.
        part: &'static str,
        /// Number that the robot has.
        found: usize,
        /// Number that it must have.
        needed: usize,
    },
    /// The robot cannot be added as asked.
    #[error("scene cannot take the robot")]
    Robot(#[source] RobotError),
}

/// Why a world cannot do what was requested; it is unchanged.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum WorldError {
    /// An action or a joint target is NaN or infinite.
    #[error("{field} of joint '{joint}' is not finite; send finite numbers")]
    Joint {
        /// Which list: `action` or `target`.
        field: &'static str,
        /// Name of the joint.
        joint: String,
    },
    /// An action is too large to be recorded.
    #[error("action of joint '{joint}' is {value:?}; send numbers from -{ACTION_LIMIT} to {ACTION_LIMIT}")]
    Action {
        /// Name of the joint.
        joint: String,
        /// The number that was found.
        value: f64,
    },
    /// The length of an action or of a list of joint targets is not the robot's number of joints.
    #[error("{field} has {found} numbers instead of {expected}; send one a joint")]
    Length {
        /// Which list: `action` or `target`.
        field: &'static str,
        /// Length that the list has.
        found: usize,
        /// Joints of the robot.
        expected: usize,
    },
    /// An external wrench is not valid.
    #[error("wrench {index} {problem}")]
    Wrench {
        /// Its place in the list.
        index: usize,
        /// Fault and remedy.
        problem: &'static str,
    },
    /// A push is NaN or infinite.
    #[error("the push has a number that is not finite; give finite ones")]
    Push,
    /// The engine refused a variation.
    #[error("cannot vary the world")]
    Variation(#[from] ModelError),
    /// A row belongs to another robot.
    #[error("row to start from: it has {found:?}, the scene's robot has {expected:?}; take a row of the same robot")]
    Layout {
        /// Sizes of the row's robot.
        found: RobotLayout,
        /// Sizes of the scene's robot.
        expected: RobotLayout,
    },
    /// No world can start from a row.
    #[error("row to start from: {field} is {value}; {rule}")]
    Row {
        /// The field at fault.
        field: &'static str,
        /// The value that was found.
        value: f64,
        /// The rule that it breaks.
        rule: &'static str,
    },
}

fn at_line(line: Option<usize>) -> String {
    line.map(|line| format!(" line {line}")).unwrap_or_default()
}
