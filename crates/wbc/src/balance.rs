//! Standing still: joint targets that keep the robot upright on level ground.
//!
//! The ankles' drives are too soft to stand on (40 N m/rad each where gravity asks for 214), so this closes a loop over
//! the centre of mass, in three steps:
//!
//! 1. Where is the centre of mass over the feet, and how does it move? From the joints, the gyroscope, the gravity
//!    direction and the velocity of the pelvis.
//! 2. Where must the ground push? An inverted pendulum of height h diverges from the centre of pressure p with the
//!    frequency w = sqrt(g/h); its divergent part is the capture point c = x + v/w with c' = w (c - p). Thus
//!    p = c + k (c - r) brings c to the reference r, and x follows.
//! 3. How do the legs push so? The ground's force passes from the centre of pressure through the centre of mass, so that
//!    it turns nothing, and carries the weight. It is shared between the feet so that the pressures' mean is p. Each leg's
//!    joint torques follow from its foot's share by the transpose of its Jacobian, and become targets through the
//!    drives' stiffness.
//!
//! Hips and knees get that torque on top of their posture, whose stiffness keeps the trunk up; the ankles' pitch gets it
//! alone, on top of the angle where it is. Everything above the legs keeps its posture.
//!
//! The feet do not step: what pushes the capture point out of the soles tips the robot over.

mod estimate;

use std::sync::Arc;

use fiatlux_robot::{Gains, JointGains, Robot, RobotError};
use fiatlux_rules::GRAVITY;
use nalgebra::{Isometry3, Point3, Vector2, Vector3};
use thiserror::Error;

use estimate::Estimator;
pub(crate) use estimate::Pendulum;

use crate::Sensed;

/// Gain of the pressure beyond the capture point, per deviation of it from the reference. The poles of the loop are -w and -k
/// w: with 1 both are those of the pendulum itself. More only sends the estimate's noise (6 mm) to the ankles.
const CAPTURE_GAIN: f64 = 1.0;

/// Largest deviation of the pressure from the soles' centre, fore and aft, m. The sole is 0.101 m long either way; its
/// edge is left alone, for a foot that rolls over it is lost.
const SOLE_REACH: f64 = 0.085;

/// Largest share of the weight that one foot is given beyond its half, of that half: both feet stay on the ground.
const LARGEST_SHIFT: f64 = 0.9;

/// Smallest half-distance of the feet, m, and height of the centre of mass above the soles, m, that are computed with. A
/// robot beyond them has fallen; the numbers stay finite.
const SMALLEST_STANCE: f64 = 0.05;
const SMALLEST_HEIGHT: f64 = 0.3;

const ANKLE_PITCH: usize = 4;

const LEG_JOINTS: [&str; 6] = ["hip_pitch", "hip_roll", "hip_yaw", "knee", "ankle_pitch", "ankle_roll"];

/// Why the controller cannot run.
#[derive(Debug, Clone, PartialEq, Error)]
#[allow(missing_docs)] // The messages say it.
pub enum BalanceError {
    #[error("balance needs {part}, which the robot {robot} does not have; use another policy for it")]
    Part { robot: String, part: String },
    #[error("{field} has {found} numbers where the robot has {expected} joints")]
    Length { field: &'static str, found: usize, expected: usize },
    #[error("{field} has a number that is not finite")]
    NotFinite { field: &'static str },
    #[error(
        "{joint} has stiffness {stiffness} N m/rad and effort limit {effort_limit} N m; balance needs both positive"
    )]
    Drive { joint: String, stiffness: f64, effort_limit: f64 },
    #[error("cannot find where the robot's links are")]
    Kinematics(#[from] RobotError),
}

/// One leg of the robot.
#[derive(Debug, Clone)]
struct Leg {
    /// Joint indices, from the hip down.
    joints: [usize; LEG_JOINTS.len()],
    foot: usize,
    /// Centre of the sole in the foot's frame, m.
    sole: Vector3<f64>,
}

/// The controller of one episode. Start a new one for each: it remembers what it has seen.
#[derive(Debug, Clone)]
pub struct Balance {
    robot: Arc<Robot>,
    gains: Gains,
    q0: Vec<f64>,
    legs: [Leg; 2],
    estimator: Estimator,
    /// As observed last, rad.
    joint_position: Vec<f64>,
    pelvis_from_link: Vec<Isometry3<f64>>,
    targets: Vec<f64>,
}

impl Balance {
    /// A controller that has seen nothing. Arrays are by joint index: `gains` are the session's, `q0` the posture that
    /// observed joint positions count from, rad.
    ///
    /// # Errors
    /// A robot without the legs of a G1, an array of another length than its joints or with a number that is not finite, or
    /// a leg's drive without stiffness or effort.
    pub fn new(robot: Arc<Robot>, gains: Gains, q0: &[f64]) -> Result<Self, BalanceError> {
        let expected = robot.joints().len();
        for (field, found) in [("gains", gains.0.len()), ("q0", q0.len())] {
            if found != expected {
                return Err(BalanceError::Length { field, found, expected });
            }
        }
        check_finite(&[("q0", q0)])?;
        let legs = [leg(&robot, "left", 0)?, leg(&robot, "right", 1)?];
        for &index in legs.iter().flat_map(|leg| &leg.joints) {
            let JointGains { stiffness, effort_limit, .. } = gains.0[index];
            if !(stiffness.is_finite() && stiffness > 0.0 && effort_limit > 0.0) {
                let joint = robot.joints()[index].name.clone();
                return Err(BalanceError::Drive { joint, stiffness, effort_limit });
            }
        }
        Ok(Self {
            estimator: Estimator::new(&robot),
            joint_position: vec![0.0; expected],
            pelvis_from_link: Vec::new(),
            targets: q0.to_vec(),
            q0: q0.to_vec(),
            legs,
            robot,
            gains,
        })
    }

    /// Forgets what it has seen.
    pub fn restart(&mut self) {
        self.estimator.restart();
    }

    /// Joint targets for the next control step with which the robot comes to a posture and keeps upright, both by joint index,
    /// rad. They may lie beyond a joint's limits.
    ///
    /// # Errors
    /// A number that is not finite or an array of the wrong length; nothing is remembered of that observation.
    pub fn step(&mut self, sensed: &Sensed<'_>, posture: &[f64]) -> Result<&[f64], BalanceError> {
        let (found, expected) = (posture.len(), self.q0.len());
        if found != expected {
            return Err(BalanceError::Length { field: "the posture", found, expected });
        }
        check_finite(&[("the posture", posture)])?;
        let pendulum = self.observe(sensed)?;
        self.push(&pendulum, posture);
        Ok(&self.targets)
    }

    /// Angles of all joints as observed last, rad.
    pub(crate) fn joint_position(&self) -> &[f64] {
        &self.joint_position
    }

    /// Notes that something else moves the robot until the next observation, and keeps it where it is.
    pub(crate) fn rest(&mut self, pendulum: &Pendulum) {
        self.estimator.pushed_at(pendulum.position);
    }

    /// Where the robot's mass is, and how it moves.
    pub(crate) fn observe(&mut self, sensed: &Sensed<'_>) -> Result<Pendulum, BalanceError> {
        check(sensed, self.q0.len())?;
        for ((q, q0), observed) in self.joint_position.iter_mut().zip(&self.q0).zip(sensed.joint_position) {
            *q = q0 + observed;
        }
        self.pelvis_from_link = self.robot.forward_kinematics(&self.joint_position, &Isometry3::identity())?;
        let feet = self.legs.each_ref().map(|leg| &self.pelvis_from_link[leg.foot]);
        let soles = [0, 1].map(|side| feet[side] * Point3::from(self.legs[side].sole));
        let up = feet[0].rotation * Vector3::z() + feet[1].rotation * Vector3::z();
        Ok(self.estimator.update(&self.robot, sensed, &self.pelvis_from_link, &up, &soles))
    }

    /// Lets the ground push as what was observed last asks for; the targets.
    pub(crate) fn push(&mut self, pendulum: &Pendulum, posture: &[f64]) -> &mut [f64] {
        let forces = ground_forces(pendulum);
        self.estimator.pushed_at(forces.pressure);
        self.targets.copy_from_slice(posture);
        let level_from_pelvis = pendulum.level_from_pelvis;
        for (leg, (force, at)) in self.legs.iter().zip(forces.feet) {
            for (part, &index) in leg.joints.iter().enumerate() {
                let (joint, gains) = (&self.robot.joints()[index], &self.gains.0[index]);
                let level_from_link = level_from_pelvis * self.pelvis_from_link[joint.link];
                let axis = level_from_link.rotation * joint.axis;
                let arm = at - level_from_link.translation.vector;
                let torque = -axis.dot(&arm.cross(&force));
                let rest = if part == ANKLE_PITCH { self.joint_position[index] } else { posture[index] };
                self.targets[index] = rest + torque.clamp(-gains.effort_limit, gains.effort_limit) / gains.stiffness;
            }
        }
        &mut self.targets
    }
}

/// The forces that the ground should exert, in the level frame.
struct GroundForces {
    /// Centre of pressure, relative to the middle between the soles, m.
    pressure: Vector2<f64>,
    /// For each foot the force, N, and the point where it acts, m.
    feet: [(Vector3<f64>, Vector3<f64>); 2],
}

/// Steps 2 and 3 of the module's documentation. The reference is the middle between the soles, where the pressure has
/// the most room.
fn ground_forces(pendulum: &Pendulum) -> GroundForces {
    let [left, right] = pendulum.soles;
    let middle = (left + right) / 2.0;
    let height = (pendulum.com.z - middle.z).max(SMALLEST_HEIGHT);
    let half_stance = ((left.y - right.y) / 2.0).max(SMALLEST_STANCE);

    let capture_point = pendulum.capture_point();
    let wanted = (1.0 + CAPTURE_GAIN) * capture_point;
    let sideways = LARGEST_SHIFT * half_stance;
    let pressure = Vector2::new(wanted.x.clamp(-SOLE_REACH, SOLE_REACH), wanted.y.clamp(-sideways, sideways));

    let through_com = ((pendulum.com - middle).xy() - pressure) / height;
    let force = pendulum.mass * GRAVITY * Vector3::new(through_com.x, through_com.y, 1.0);
    // Sideways the feet's shares alone move the pressure: a sole is narrow. Fore and aft it moves alike under both, beyond
    // what the shares do to feet that are not abreast.
    let left_share = 0.5 * (1.0 + pressure.y / half_stance);
    let forward = Vector3::new(pressure.x - (left_share - 0.5) * (left.x - right.x), 0.0, 0.0);
    let feet = [(left_share * force, left + forward), ((1.0 - left_share) * force, right + forward)];
    GroundForces { pressure, feet }
}

fn leg(robot: &Robot, side: &str, foot: usize) -> Result<Leg, BalanceError> {
    let lacks = |part: String| BalanceError::Part { robot: robot.name().into(), part };
    let mut joints = [0; LEG_JOINTS.len()];
    for (joint, part) in joints.iter_mut().zip(LEG_JOINTS) {
        let name = format!("{side}_{part}_joint");
        *joint = robot.joint_index(&name).ok_or_else(|| lacks(name))?;
    }
    let foot = *robot.feet().get(foot).ok_or_else(|| lacks(format!("a {side} foot")))?;
    let sole = robot.shapes().iter().find(|shape| shape.link == foot);
    let sole = sole.ok_or_else(|| lacks(format!("a {side} sole")))?.link_from_shape.translation.vector;
    Ok(Leg { joints, foot, sole })
}

/// Refuses an observation of the wrong length or with a number that is not finite; the kinematics checks the joint
/// positions.
fn check(sensed: &Sensed<'_>, joints: usize) -> Result<(), BalanceError> {
    let found = sensed.joint_position.len();
    if found != joints {
        return Err(BalanceError::Length { field: "the observed joint position", found, expected: joints });
    }
    check_finite(&[
        ("the observed base angular velocity", &sensed.base_angular_velocity),
        ("the observed projected gravity", &sensed.projected_gravity),
        ("the observed base linear velocity", &sensed.base_linear_velocity),
    ])
}

fn check_finite(arrays: &[(&'static str, &[f64])]) -> Result<(), BalanceError> {
    match arrays.iter().find(|(_, values)| values.iter().any(|value| !value.is_finite())) {
        Some(&(field, _)) => Err(BalanceError::NotFinite { field }),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests;
