//! What a policy asks of the robot, and the one check of it at both ends of a session.

use fiatlux_proto::v3::{Action, Joint, SessionInfo};
use thiserror::Error;

/// What the robot is told to do for one step: a number for each joint, in the order of `SessionInfo.joints`.
#[derive(Debug, Clone, PartialEq)]
pub enum Command {
    /// In action units: joint target = q0 + action_scale * action.
    Action(Vec<f64>),
    /// Joint targets, rad.
    JointTarget(Vec<f64>),
}

/// Why a command is not carried out.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum CommandError {
    /// Not exactly one of the two forms.
    #[error("{} filled", if *.both { "both action and joint_target are" } else { "neither action nor joint_target is" })]
    Form {
        /// Both are filled; otherwise neither is.
        both: bool,
    },
    /// Not a number for each joint.
    #[error("{field} has {found} numbers instead of {expected}")]
    Length {
        /// `action` or `joint_target`.
        field: &'static str,
        /// How many there are.
        found: usize,
        /// How many joints the robot has.
        expected: usize,
    },
    /// NaN, infinite, or too large to be an action.
    #[error("{field} of joint '{name}' is not finite")]
    NotFinite {
        /// `action` or `joint_target`.
        field: &'static str,
        /// Index of the joint.
        joint: usize,
        /// Its name.
        name: String,
        /// The number.
        value: f64,
    },
}

impl CommandError {
    /// The field of the message that is wrong.
    pub fn field(&self) -> &'static str {
        match self {
            Self::Form { .. } => "action",
            Self::Length { field, .. } | Self::NotFinite { field, .. } => field,
        }
    }
}

impl Command {
    /// What an action that arrived asks for, checked against the session.
    ///
    /// # Errors
    /// [`CommandError`]: the form, the length, or a number that is not finite.
    pub fn of(action: &Action, info: &SessionInfo) -> Result<Self, CommandError> {
        let command = match (action.action.is_empty(), action.joint_target.is_empty()) {
            (false, true) => Self::Action(action.action.clone()),
            (true, false) => Self::JointTarget(action.joint_target.clone()),
            (neither, _) => return Err(CommandError::Form { both: !neither }),
        };
        command.check(info).map(|()| command)
    }

    /// Whether a session takes it.
    ///
    /// # Errors
    /// [`CommandError`]: the length, or a number that is not finite, in action units either.
    pub fn check(&self, info: &SessionInfo) -> Result<(), CommandError> {
        let (field, numbers) = match self {
            Self::Action(numbers) => ("action", numbers),
            Self::JointTarget(numbers) => ("joint_target", numbers),
        };
        let joints = &info.joints;
        if numbers.len() != joints.len() {
            return Err(CommandError::Length { field, found: numbers.len(), expected: joints.len() });
        }
        let is_finite = |(number, joint): (&f64, &Joint)| match self {
            Self::Action(_) => number.is_finite(),
            Self::JointTarget(_) => ((number - joint.q0) / info.action_scale).is_finite(),
        };
        match numbers.iter().zip(joints).position(|pair| !is_finite(pair)) {
            None => Ok(()),
            Some(joint) => {
                let name = joints[joint].name.clone();
                Err(CommandError::NotFinite { field, joint, name, value: numbers[joint] })
            }
        }
    }

    /// The message that carries it.
    pub fn into_action(self, episode: u64, step: u64) -> Action {
        let (action, joint_target) = match self {
            Self::Action(numbers) => (numbers, Vec::new()),
            Self::JointTarget(numbers) => (Vec::new(), numbers),
        };
        Action { episode, step, action, joint_target }
    }
}
