//! The input of a control step.

use fiatlux_dynamics::{BodyId, Wrench};
use nalgebra::Vector3;

/// Input of a control step. Without wrenches and push it corresponds to an episode's action.
///
/// Rows record neither wrenches nor pushes, and an [`Episode`](crate::Episode) takes none: they are for training and tests.
/// The same inputs from the same row still give the same rows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ControlInput<'a> {
    /// The action as received, to record in the row: one number for each joint.
    pub action: &'a [f64],
    /// Joint targets, rad, in the public joint order; they are clamped to the joints' limits.
    pub joint_target: &'a [f64],
    /// Wrenches held over the control step. More than 8 at once cause an allocation.
    pub wrenches: &'a [AppliedWrench],
    /// A sudden change of the robot's velocity, before the first physics step.
    pub push: Option<Push>,
}

impl<'a> ControlInput<'a> {
    /// Joint targets alone: no wrenches and no push.
    pub fn new(action: &'a [f64], joint_target: &'a [f64]) -> Self {
        Self { action, joint_target, wrenches: &[], push: None }
    }
}

/// The thing that a wrench acts on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Target {
    /// A link of the robot, by index into [`Robot::links`](fiatlux_robot::Robot::links).
    Link(usize),
    /// A body of the model, such as the ladder's.
    Body(BodyId),
}

/// An external force and torque. They keep their direction in the world over the control step; the force keeps the line
/// of action that it has at the start of the step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AppliedWrench {
    /// The link or body that it acts on.
    pub target: Target,
    /// Point of application in the target's frame, m; `None` for the target's centre of mass.
    pub point: Option<Vector3<f64>>,
    /// Force and torque about that point, world axes.
    pub wrench: Wrench,
}

/// A velocity that is added to the robot as a whole: to its root, not to its joints.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Push {
    /// Velocity of the pelvis's origin to add, world axes, m/s.
    pub linear: Vector3<f64>,
    /// Angular velocity to add, world axes, rad/s.
    pub angular: Vector3<f64>,
}
