//! What a control step takes.

use fiatlux_dynamics::{BodyId, Wrench};
use nalgebra::Vector3;

/// Input of a control step. Without wrenches and push it is what an episode's action comes down to.
///
/// Rows record neither wrenches nor pushes, and an [`Episode`](crate::Episode) takes none: they are for training and tests.
/// The same inputs from the same row still give the same rows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ControlInput<'a> {
    /// What was received, for the record: a number a joint.
    pub action: &'a [f64],
    /// rad, in the public joint order; beyond a joint's limits they are clamped to them.
    pub joint_target: &'a [f64],
    /// Held over the control step. More than 8 at once allocate.
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

/// What a wrench acts on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Target {
    /// A link of the robot, by index into [`Robot::links`](fiatlux_robot::Robot::links).
    Link(usize),
    /// A body of the model, such as the ladder's.
    Body(BodyId),
}

/// An external force and torque. They keep their direction in the world over the control step; the line of the force is that
/// of the step's start.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AppliedWrench {
    /// What it acts on.
    pub target: Target,
    /// Where the force acts, in the target's frame, m; none for the target's centre of mass.
    pub point: Option<Vector3<f64>>,
    /// Force and torque about that point, world axes.
    pub wrench: Wrench,
}

/// A velocity that is added to the robot as a whole: its root's changes, its joints' do not.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Push {
    /// Of the pelvis's origin, world axes, m/s.
    pub linear: Vector3<f64>,
    /// Angular velocity to add, world axes, rad/s.
    pub angular: Vector3<f64>,
}
