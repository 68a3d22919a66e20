//! The flat vector as a table: what stands where, its scale and its noise.
//!
//! Order, scales and noise are those of the published `FIATLUX-Replace-v0` and `FIATLUX-Climb-v0` (`replace_env_cfg` and
//! `climb_env_cfg`, group `policy`).

use fiatlux_rules::{LIMBS, Task};

use crate::lidar::LIDAR_RAYS;

/// Joints and bodies of a hand of the published robot.
const JOINTS: usize = 53;
const HAND_BODIES_PER_SIDE: usize = 17;

/// Features of the head camera's image.
pub const FEATURES: usize = 512;

/// What a term of the flat vector is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Signal {
    /// [`crate::Proprioception::base_angular_velocity`].
    BaseAngularVelocity,
    /// [`crate::Proprioception::projected_gravity`].
    ProjectedGravity,
    /// [`crate::Proprioception::base_linear_velocity`].
    BaseLinearVelocity,
    /// [`crate::Proprioception::base_height`].
    BaseHeight,
    /// [`crate::Proprioception::joint_position`].
    JointPosition,
    /// [`crate::Proprioception::joint_velocity`].
    JointVelocity,
    /// Force of both bulbs on each body of the right hand.
    RightHandContact,
    /// Force of both bulbs on each body of the left hand.
    LeftHandContact,
    /// Force of the ladder on feet and palms.
    LimbContact,
    /// Features of the head camera's image.
    CameraFeatures,
    /// Ranges of the LiDAR.
    Lidar,
    /// The last action.
    LastAction,
}

/// A run of numbers in the flat vector. Each is (measured + noise) x scale.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ObservationTerm {
    /// Name, also of its stream of noise.
    pub name: &'static str,
    /// What it is.
    pub signal: Signal,
    /// Its first number in the flat vector.
    pub offset: usize,
    /// How many numbers.
    pub length: usize,
    /// Factor, after noise.
    pub scale: f64,
    /// Half-width of its uniform noise, in `unit`; 0 for none.
    pub noise: f64,
    /// Unit before scaling; empty for pure numbers.
    pub unit: &'static str,
    /// What the numbers are, in their order.
    pub meaning: &'static str,
}

const fn term(
    name: &'static str,
    signal: Signal,
    length: usize,
    scale: f64,
    noise: f64,
    unit: &'static str,
    meaning: &'static str,
) -> ObservationTerm {
    ObservationTerm { name, signal, offset: 0, length, scale, noise, unit, meaning }
}

pub(super) const BASE_ANGULAR_VELOCITY: ObservationTerm = term(
    "base_angular_velocity",
    Signal::BaseAngularVelocity,
    3,
    1.0,
    0.2,
    "rad/s",
    "angular velocity of the pelvis, pelvis frame",
);
pub(super) const PROJECTED_GRAVITY: ObservationTerm =
    term("projected_gravity", Signal::ProjectedGravity, 3, 1.0, 0.05, "", "direction of gravity, pelvis frame");
pub(super) const BASE_LINEAR_VELOCITY: ObservationTerm = term(
    "base_linear_velocity",
    Signal::BaseLinearVelocity,
    3,
    1.0,
    0.1,
    "m/s",
    "velocity of the pelvis link's origin, pelvis frame",
);
pub(super) const BASE_HEIGHT: ObservationTerm =
    term("base_height", Signal::BaseHeight, 1, 1.0, 0.05, "m", "height of the pelvis link's origin in the world");
pub(super) const JOINT_POSITION: ObservationTerm =
    term("joint_position", Signal::JointPosition, JOINTS, 1.0, 0.01, "rad", "joint angles less those of q0");
pub(super) const JOINT_VELOCITY: ObservationTerm =
    term("joint_velocity", Signal::JointVelocity, JOINTS, 1.0, 1.5, "rad/s", "joint velocities");
const RIGHT_HAND_CONTACT: ObservationTerm = term(
    "right_hand_contact",
    Signal::RightHandContact,
    3 * HAND_BODIES_PER_SIDE,
    0.1,
    0.0,
    "N",
    "force of both bulbs on each of 17 bodies of the right hand, world axes",
);
const LEFT_HAND_CONTACT: ObservationTerm = term(
    "left_hand_contact",
    Signal::LeftHandContact,
    3 * HAND_BODIES_PER_SIDE,
    0.1,
    0.0,
    "N",
    "the same of the left hand",
);
const LIMB_CONTACT: ObservationTerm = term(
    "limb_contact",
    Signal::LimbContact,
    3 * LIMBS,
    0.1,
    0.0,
    "N",
    "force of the ladder on left and right foot (estimated) and on left and right palm, world axes",
);
const CAMERA_FEATURES: ObservationTerm =
    term("camera_features", Signal::CameraFeatures, FEATURES, 1.0, 0.0, "", "ResNet-18 features of the head camera");
const LIDAR: ObservationTerm = term(
    "lidar",
    Signal::Lidar,
    LIDAR_RAYS,
    0.1,
    0.0,
    "m",
    "range by elevation, then azimuth: entry 180 row + column; 10 m where nothing is hit",
);
const LAST_ACTION: ObservationTerm =
    term("last_action", Signal::LastAction, JOINTS, 1.0, 0.0, "", "the action that led here, as received");

/// One after another, from 0.
const fn in_a_row<const N: usize>(mut terms: [ObservationTerm; N]) -> [ObservationTerm; N] {
    let (mut offset, mut index) = (0, 0);
    while index < N {
        terms[index].offset = offset;
        offset += terms[index].length;
        index += 1;
    }
    terms
}

/// All tasks but `climb`.
static STANDARD: [ObservationTerm; 11] = in_a_row([
    BASE_ANGULAR_VELOCITY,
    PROJECTED_GRAVITY,
    BASE_LINEAR_VELOCITY,
    BASE_HEIGHT,
    JOINT_POSITION,
    JOINT_VELOCITY,
    RIGHT_HAND_CONTACT,
    LEFT_HAND_CONTACT,
    CAMERA_FEATURES,
    LIDAR,
    LAST_ACTION,
]);

/// `climb`, which reads the limbs in place of the hands.
static CLIMB: [ObservationTerm; 10] = in_a_row([
    BASE_ANGULAR_VELOCITY,
    PROJECTED_GRAVITY,
    BASE_LINEAR_VELOCITY,
    BASE_HEIGHT,
    JOINT_POSITION,
    JOINT_VELOCITY,
    LIMB_CONTACT,
    CAMERA_FEATURES,
    LIDAR,
    LAST_ACTION,
]);

/// The terms of a task's flat vector, in their order.
pub fn observation_terms(task: Task) -> &'static [ObservationTerm] {
    if task == Task::Climb { &CLIMB } else { &STANDARD }
}

/// Numbers in a task's flat vector: 6,543, and 6,453 in `climb`.
pub fn observation_length(task: Task) -> usize {
    observation_terms(task).iter().map(|term| term.length).sum()
}
