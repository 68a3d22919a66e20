//! Parts of a row: bodies, limbs, bulbs, and the sizes that depend on the robot.

use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

/// Limbs whose contact with floor and ladder is sensed, and limbs that may carry the robot.
pub const LIMBS: usize = 4;

/// The sizes of a row that depend on the robot. They come with the robot's data file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct RobotLayout {
    /// Number of driven joints, and so the length of every list by joint.
    pub joints: usize,
    /// Sensed bodies of each hand.
    pub hand_bodies_per_side: usize,
}

impl RobotLayout {
    /// Sensed bodies of both hands: the right hand's, then the left hand's.
    pub const fn hand_bodies(self) -> usize {
        2 * self.hand_bodies_per_side
    }
}

/// Joints that terms of rewards read: indices in the public order. They come with the robot's data file.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct JointGroups {
    /// Hips and knees.
    pub legs: Vec<usize>,
    /// Ankles, each with its lower and upper limit, rad.
    pub ankles: Vec<(usize, [f64; 2])>,
    /// Joints between pelvis and torso.
    pub waist: Vec<usize>,
    /// All joints of both hands.
    pub fingers: Vec<usize>,
}

/// Index into the two bulbs of a row.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Bulb {
    /// The spent bulb, which the errand takes out of the lamp.
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
    /// The palm of the left hand.
    LeftPalm = 2,
    /// The palm of the right hand.
    RightPalm = 3,
}

/// Index into the limbs that may carry the robot.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Support {
    /// Left ankle roll link.
    LeftFoot = 0,
    /// Right ankle roll link.
    RightFoot = 1,
    /// Left arm from the elbow down: forearm, wrist and every body of the hand.
    LeftArm = 2,
    /// Right arm from the elbow down.
    RightArm = 3,
}

/// Pose and velocity of a body: of its link origin, in world axes.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(from = "[f64; 13]", into = "[f64; 13]")]
pub struct BodyRow {
    /// Pose in the world, m.
    pub pose: Isometry3<f64>,
    /// Velocity of the link's origin, m/s.
    pub linear_velocity: Vector3<f64>,
    /// Angular velocity of the body, rad/s.
    pub angular_velocity: Vector3<f64>,
}

impl BodyRow {
    /// A body that does not move.
    pub fn at_rest(pose: Isometry3<f64>) -> Self {
        Self { pose, linear_velocity: Vector3::zeros(), angular_velocity: Vector3::zeros() }
    }
}

/// Position, quaternion (w, x, y, z), linear and angular velocity.
impl From<BodyRow> for [f64; 13] {
    fn from(BodyRow { pose, linear_velocity, angular_velocity }: BodyRow) -> Self {
        let (p, q, v, w) = (pose.translation.vector, pose.rotation.into_inner(), linear_velocity, angular_velocity);
        [p.x, p.y, p.z, q.w, q.i, q.j, q.k, v.x, v.y, v.z, w.x, w.y, w.z]
    }
}

impl From<[f64; 13]> for BodyRow {
    fn from([x, y, z, qw, qx, qy, qz, vx, vy, vz, wx, wy, wz]: [f64; 13]) -> Self {
        // As it was: normalised again, it might differ in its last bit.
        let rotation = UnitQuaternion::new_unchecked(Quaternion::new(qw, qx, qy, qz));
        Self {
            pose: Isometry3::from_parts(Translation3::new(x, y, z), rotation),
            linear_velocity: Vector3::new(vx, vy, vz),
            angular_velocity: Vector3::new(wx, wy, wz),
        }
    }
}

/// The socket's hold on a bulb.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct AttachmentRow {
    /// Held in the socket.
    pub seated: bool,
    /// Consecutive control steps that a held bulb has spent beyond the release gap.
    pub steps_beyond: u32,
}

impl AttachmentRow {
    /// Not in the socket.
    pub const FREE: Self = Self { seated: false, steps_beyond: 0 };
}
