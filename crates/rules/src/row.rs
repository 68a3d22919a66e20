//! One row of state: everything that a gate, a reward or a metric reads, and that a world needs to continue from there.

use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

/// Length of a control step, s: the time from one row to the next.
pub const CONTROL_DT: f64 = 0.02;

/// Limbs whose contact with floor and ladder is sensed, and limbs that may carry the robot.
pub const LIMBS: usize = 4;

/// Height of the lowest tread that counts as up the ladder, m: the second of four. Standing on it lifts the pelvis to 1.26 m,
/// above what the published gate of S02 asks for; the first tread does not.
pub const HIGH_TREAD_HEIGHT: f64 = 0.47;

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

/// The state after a control step; row 0 is the reset state. Lists have the lengths of the row's [`RobotLayout`].
#[derive(Debug, PartialEq)]
pub struct Row {
    /// Number of control steps since reset.
    pub step: u64,
    /// Pose and velocity of the robot's pelvis.
    pub robot: BodyRow,
    /// Velocity of the robot's centre of mass, m/s.
    pub com_velocity: Vector3<f64>,
    /// Poses of the left and the right palm in the world, m.
    pub world_from_palm: [Isometry3<f64>; 2],
    /// Angles of the joints, rad, in the public joint order.
    pub joint_position: Vec<f64>,
    /// Speeds of the joints in the same order, rad/s.
    pub joint_velocity: Vec<f64>,
    /// Targets that led to this row, rad.
    pub joint_target: Vec<f64>,
    /// Efforts that the drives applied in the last physics step, N m.
    pub joint_effort: Vec<f64>,
    /// The action that led to this row as it was received; in row 0 the staged posture in action units.
    pub action: Vec<f64>,
    /// Pose and velocity of the ladder.
    pub ladder: BodyRow,
    /// Both bulbs, by [`Bulb`].
    pub bulbs: [BodyRow; 2],
    /// Pose of the lamp's socket in the world, m.
    pub fixture: Isometry3<f64>,
    /// Pose of the disposal crate in the world, m.
    pub crate_: Isometry3<f64>,
    /// Contact force of each bulb on each sensed hand body in the last physics step, world axes, N.
    pub hand_force: [Vec<Vector3<f64>>; 2],
    /// The largest magnitude of it over the control step's physics steps, N.
    pub hand_force_peak: [Vec<f64>; 2],
    /// Contact force on each bulb of the one thing that pressed hardest, of all things but the sensed hand bodies (floor, ladder,
    /// furniture with socket and walls, the other bulb, the rest of the robot), summed over its contact points without regard to
    /// direction, N; the largest over the control step's physics steps. 0 in row 0.
    pub other_force_peak: [f64; 2],
    /// Upward force of the floor on each limb, by [`Support`], N; mean over the control step's physics steps. 0 in row 0.
    pub floor_load: [f64; LIMBS],
    /// Upward force of the ladder's treads from [`HIGH_TREAD_HEIGHT`] on and of its platform, likewise.
    pub tread_load: [f64; LIMBS],
    /// Contact force of the floor on each limb in the last physics step, by [`Limb`], world axes, N.
    pub floor_force: [Vector3<f64>; LIMBS],
    /// Contact force of the ladder on each limb in the last physics step, by [`Limb`], world axes, N.
    pub ladder_force: [Vector3<f64>; LIMBS],
    /// The socket's hold on each bulb.
    pub attachments: [AttachmentRow; 2],
    /// Physics steps of this control step whose solve did not converge, on the second try either. In row 0, as `retried`, those
    /// of the staging.
    pub unconverged: u32,
    /// Physics steps of this control step whose first solve did not converge.
    pub retried: u32,
    /// Largest speed of a joint with a rated speed (the body's; fingers have none) at the end of a physics step of this
    /// control step, rad/s; 0 in row 0. Infinite where a physics step led to a state that is not finite: the row then has the
    /// state before it.
    pub joint_speed_peak: f64,
    /// Depth of the deepest contact point in the physics steps of this control step, m; 0 in row 0.
    pub penetration: f64,
}

impl Row {
    /// A row of step 0 with every number 0, every pose the identity, and no bulb in the socket.
    pub fn zeros(layout: RobotLayout) -> Self {
        let joints = vec![0.0; layout.joints];
        let hands = layout.hand_bodies();
        let origin = BodyRow::at_rest(Isometry3::identity());
        Self {
            step: 0,
            robot: origin,
            com_velocity: Vector3::zeros(),
            world_from_palm: [Isometry3::identity(); 2],
            joint_position: joints.clone(),
            joint_velocity: joints.clone(),
            joint_target: joints.clone(),
            joint_effort: joints.clone(),
            action: joints,
            ladder: origin,
            bulbs: [origin; 2],
            fixture: Isometry3::identity(),
            crate_: Isometry3::identity(),
            hand_force: [vec![Vector3::zeros(); hands], vec![Vector3::zeros(); hands]],
            hand_force_peak: [vec![0.0; hands], vec![0.0; hands]],
            other_force_peak: [0.0; 2],
            floor_load: [0.0; LIMBS],
            tread_load: [0.0; LIMBS],
            floor_force: [Vector3::zeros(); LIMBS],
            ladder_force: [Vector3::zeros(); LIMBS],
            attachments: [AttachmentRow::FREE; 2],
            unconverged: 0,
            retried: 0,
            joint_speed_peak: 0.0,
            penetration: 0.0,
        }
    }

    /// The sizes of its lists.
    pub fn layout(&self) -> RobotLayout {
        RobotLayout { joints: self.joint_position.len(), hand_bodies_per_side: self.hand_force[0].len() / 2 }
    }

    /// Contact force of a bulb on the bodies of the right hand, then of the left hand, world axes, N.
    pub fn hands(&self, bulb: Bulb) -> [&[Vector3<f64>]; 2] {
        let forces = &self.hand_force[bulb as usize];
        let (right, left) = forces.split_at(forces.len() / 2);
        [right, left]
    }

    /// Whether all its lists have the lengths of a layout.
    pub fn fits(&self, layout: RobotLayout) -> bool {
        let joints = [&self.joint_position, &self.joint_velocity, &self.joint_target, &self.joint_effort, &self.action];
        let bodies = layout.hand_bodies();
        joints.iter().all(|list| list.len() == layout.joints)
            && self.hand_force.iter().all(|list| list.len() == bodies)
            && self.hand_force_peak.iter().all(|list| list.len() == bodies)
    }
}

impl Clone for Row {
    fn clone(&self) -> Self {
        let mut row = Self::zeros(self.layout());
        row.clone_from(self);
        row
    }

    /// Copies into its present lists: no allocation between rows of one layout.
    fn clone_from(&mut self, source: &Self) {
        let Self {
            step,
            robot,
            com_velocity,
            world_from_palm,
            joint_position,
            joint_velocity,
            joint_target,
            joint_effort,
            action,
            ladder,
            bulbs,
            fixture,
            crate_,
            hand_force,
            hand_force_peak,
            other_force_peak,
            floor_load,
            tread_load,
            floor_force,
            ladder_force,
            attachments,
            unconverged,
            retried,
            joint_speed_peak,
            penetration,
        } = self;
        *step = source.step;
        *robot = source.robot;
        *com_velocity = source.com_velocity;
        *world_from_palm = source.world_from_palm;
        joint_position.clone_from(&source.joint_position);
        joint_velocity.clone_from(&source.joint_velocity);
        joint_target.clone_from(&source.joint_target);
        joint_effort.clone_from(&source.joint_effort);
        action.clone_from(&source.action);
        *ladder = source.ladder;
        *bulbs = source.bulbs;
        *fixture = source.fixture;
        *crate_ = source.crate_;
        hand_force.clone_from(&source.hand_force);
        hand_force_peak.clone_from(&source.hand_force_peak);
        *other_force_peak = source.other_force_peak;
        *floor_load = source.floor_load;
        *tread_load = source.tread_load;
        *floor_force = source.floor_force;
        *ladder_force = source.ladder_force;
        *attachments = source.attachments;
        *unconverged = source.unconverged;
        *retried = source.retried;
        *joint_speed_peak = source.joint_speed_peak;
        *penetration = source.penetration;
    }
}
