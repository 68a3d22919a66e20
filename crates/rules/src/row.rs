//! One row of state: everything that a gate, a reward or a metric reads, and all that a world needs to go on from there.

use nalgebra::{Isometry3, Vector3};

/// Driven joints of the robot.
pub const JOINTS: usize = 53;
/// Sensed bodies of each hand.
pub const HAND_BODIES_PER_SIDE: usize = 17;
/// Sensed hand bodies: the right hand's, then the left hand's.
pub const HAND_BODIES: usize = 2 * HAND_BODIES_PER_SIDE;
/// Limbs whose load on the ladder is sensed.
pub const LIMBS: usize = 4;

/// Index into the two bulbs of a row.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Bulb {
    /// The spent one.
    Old = 0,
    /// The one that replaces it.
    Fresh = 1,
}

impl Bulb {
    /// Both, in the order of a row.
    pub const ALL: [Bulb; 2] = [Bulb::Old, Bulb::Fresh];
}

/// Index into the sensed limbs of a row.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Limb {
    /// Left ankle roll link.
    LeftFoot = 0,
    /// Right ankle roll link.
    RightFoot = 1,
    /// Left palm.
    LeftPalm = 2,
    /// Right palm.
    RightPalm = 3,
}

/// Pose and velocity of a body: of its link origin, in world axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BodyRow {
    /// Pose in the world, m.
    pub pose: Isometry3<f64>,
    /// m/s.
    pub linear_velocity: Vector3<f64>,
    /// rad/s.
    pub angular_velocity: Vector3<f64>,
}

/// The socket's hold on a bulb.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct AttachmentRow {
    /// Held in the socket.
    pub seated: bool,
    /// Consecutive control steps that a held bulb has spent beyond the release gap.
    pub steps_beyond: u32,
}

/// The state after a control step; row 0 is the reset state.
#[derive(Debug, Clone, PartialEq)]
pub struct Row {
    /// Number of control steps since reset.
    pub step: u64,
    /// The pelvis.
    pub robot: BodyRow,
    /// Velocity of the robot's centre of mass, m/s.
    pub com_velocity: Vector3<f64>,
    /// Origins of the left and the right palm, m.
    pub palm_position: [Vector3<f64>; 2],
    /// rad, in the public joint order.
    pub joint_position: [f64; JOINTS],
    /// rad/s.
    pub joint_velocity: [f64; JOINTS],
    /// Targets that led to this row, rad.
    pub joint_target: [f64; JOINTS],
    /// Efforts that the drives applied in the last physics step, N m.
    pub joint_effort: [f64; JOINTS],
    /// The action that led to this row as it was received; in row 0 the staged posture in action units.
    pub action: [f64; JOINTS],
    /// The ladder.
    pub ladder: BodyRow,
    /// Both bulbs, by [`Bulb`].
    pub bulbs: [BodyRow; 2],
    /// The socket.
    pub fixture: Isometry3<f64>,
    /// The crate.
    pub crate_: Isometry3<f64>,
    /// Contact force of each bulb on each sensed hand body in the last physics step, world axes, N.
    pub hand_force: [[Vector3<f64>; HAND_BODIES]; 2],
    /// The largest magnitude of it over the control step's physics steps, N.
    pub hand_force_peak: [[f64; HAND_BODIES]; 2],
    /// Contact force of the ladder on each limb in the last physics step, by [`Limb`], world axes, N.
    pub limb_force: [Vector3<f64>; LIMBS],
    /// The socket's hold on each bulb.
    pub attachments: [AttachmentRow; 2],
    /// Physics steps of this control step whose solve did not converge.
    pub unconverged: u32,
}
