//! Postures by inverse kinematics: weighted least squares with a numeric Jacobian. For building start states of checks,
//! not for control.
#![allow(clippy::unwrap_used, clippy::missing_panics_doc)]

use fiatlux_dynamics::Contact;
use fiatlux_robot::{Gains, Robot};
use fiatlux_rules::GRAVITY;
use fiatlux_world::{Scene, ShapeOwner};
use nalgebra::{DMatrix, DVector, Isometry3, Point3, Translation3, UnitQuaternion, Vector3};

use crate::Rig;

/// Joints stay this far from their limits, whose springs would load the posture, rad.
const LIMIT_MARGIN: f64 = 0.02;

/// Where the robot is and how it is bent.
#[derive(Debug, Clone)]
pub struct Posture {
    /// Pose of the root.
    pub world_from_pelvis: Isometry3<f64>,
    /// Joint angles in the public order, rad.
    pub joints: Vec<f64>,
}

impl Posture {
    /// Puts a rig's robot into the posture, with its targets there.
    pub fn apply(&self, rig: &mut Rig) {
        rig.set_joints(&self.joints);
        rig.place_robot(&self.world_from_pelvis);
    }

    pub fn link_poses(&self, robot: &Robot) -> Vec<Isometry3<f64>> {
        robot.forward_kinematics(&self.joints, &self.world_from_pelvis).unwrap()
    }

    /// Centre of mass, m.
    pub fn center_of_mass(&self, robot: &Robot) -> Vector3<f64> {
        robot.center_of_mass(&self.joints, &self.world_from_pelvis).unwrap()
    }

    /// Moved along 6 root coordinates (m, rad in world axes) and the listed joints, kept within their limits.
    fn moved(&self, robot: &Robot, joints: &[usize], change: &[f64]) -> Self {
        let mut moved = self.clone();
        let [shift, turn] = [0, 3].map(|i| Vector3::from_column_slice(&change[i..i + 3]));
        moved.world_from_pelvis.translation = Translation3::from(self.world_from_pelvis.translation.vector + shift);
        moved.world_from_pelvis.rotation = UnitQuaternion::from_scaled_axis(turn) * self.world_from_pelvis.rotation;
        for (&joint, step) in joints.iter().zip(&change[6..]) {
            let limits = &robot.joints()[joint];
            moved.joints[joint] =
                (self.joints[joint] + step).clamp(limits.lower + LIMIT_MARGIN, limits.upper - LIMIT_MARGIN);
        }
        moved
    }
}

/// Takes one damped Gauss-Newton step on the sum of squared residuals over the root and the listed joints.
pub fn improve(
    robot: &Robot,
    posture: &Posture,
    joints: &[usize],
    residuals: impl Fn(&Posture, &[Isometry3<f64>]) -> Vec<f64>,
) -> Posture {
    const STEP: f64 = 1e-6;
    const LONGEST: f64 = 0.1;
    let value = |p: &Posture| DVector::from_vec(residuals(p, &p.link_poses(robot)));
    let here = value(posture);
    let count = 6 + joints.len();
    let mut jacobian = DMatrix::zeros(here.len(), count);
    for column in 0..count {
        let mut change = vec![0.0; count];
        // Away from the nearer limit.
        let limits = column.checked_sub(6).map(|i| (&robot.joints()[joints[i]], posture.joints[joints[i]]));
        change[column] = if limits.is_some_and(|(j, q)| 2.0 * q > j.lower + j.upper) { -STEP } else { STEP };
        let there = value(&posture.moved(robot, joints, &change));
        jacobian.set_column(column, &((there - &here) / change[column]));
    }
    let mut change = DVector::zeros(count);
    // Joints that would leave their limits stand still; the others make up for it.
    let mut stuck = vec![false; count];
    for _ in 0..5 {
        let normal = jacobian.transpose() * &jacobian + DMatrix::identity(count, count) * 1e-6;
        change = -normal.cholesky().unwrap().solve(&(jacobian.transpose() * &here));
        let mut found = false;
        for (i, &joint) in joints.iter().enumerate() {
            let (limits, q) = (&robot.joints()[joint], posture.joints[joint]);
            let outward = (q >= limits.upper - LIMIT_MARGIN && change[6 + i] > 0.0)
                || (q <= limits.lower + LIMIT_MARGIN && change[6 + i] < 0.0);
            if outward && !stuck[6 + i] {
                (stuck[6 + i], found) = (true, true);
                jacobian.set_column(6 + i, &DVector::zeros(here.len()));
            }
        }
        if !found {
            break;
        }
    }
    let longest = change.amax();
    if longest > LONGEST {
        change *= LONGEST / longest;
    }
    posture.moved(robot, joints, change.as_slice())
}

/// Targets with which drives hold a posture on its feet: the joint angles plus what gravity takes out of the springs
/// when each foot carries half the weight, straight below the centre of mass.
pub fn held_targets(robot: &Robot, posture: &Posture, gains: &Gains) -> Vec<f64> {
    const STEP: f64 = 1e-6;
    let poses = posture.link_poses(robot);
    let com = posture.center_of_mass(robot);
    let weight = GRAVITY * robot.total_mass();
    let soles: Vec<(usize, Point3<f64>)> = robot
        .feet()
        .iter()
        .map(|&foot| {
            // On the line through the ankle along the foot, where the centre of mass is abreast.
            let (ankle, ahead) = (poses[foot].translation.vector, poses[foot] * Vector3::x());
            let load = ankle + ahead * (com - ankle).dot(&ahead);
            (foot, poses[foot].inverse_transform_point(&load.into()))
        })
        .collect();
    // Its slope by a joint angle, the pelvis held, is the effort of that joint.
    let potential = |p: &Posture| {
        let poses = p.link_poses(robot);
        let carried: f64 = soles.iter().map(|(foot, point)| (poses[*foot] * point).z / 2.0).sum();
        weight * (p.center_of_mass(robot).z - carried)
    };
    let mut targets = posture.joints.clone();
    for joint in 0..targets.len() {
        let at = |step: f64| {
            let mut p = posture.clone();
            p.joints[joint] += step;
            potential(&p)
        };
        let drive = &gains.0[joint];
        let effort = (at(STEP) - at(-STEP)) / (2.0 * STEP);
        targets[joint] += effort.clamp(-drive.effort_limit, drive.effort_limit) / drive.stiffness;
    }
    targets
}

/// A pair of surfaces near each other: how its gap changes as the robot moves, to first order.
#[derive(Debug, Clone)]
pub struct Nearness {
    gap: f64,
    /// Gap to keep, m.
    pub keep: f64,
    normal: Vector3<f64>,
    /// Link and the contact point in it, first and second side; none for what is not the robot's.
    sides: [Option<(usize, Point3<f64>)>; 2],
    at: Vector3<f64>,
}

impl Nearness {
    /// Gap in another posture, m.
    pub fn gap(&self, poses: &[Isometry3<f64>]) -> f64 {
        let point = |side: &Option<(usize, Point3<f64>)>| match side {
            Some((link, point)) => (poses[*link] * point).coords,
            None => self.at,
        };
        self.gap + self.normal.dot(&(point(&self.sides[1]) - point(&self.sides[0])))
    }
}

/// All pairs of a rig's present configuration that involve the robot, have a gap below `margin` m, and for which `keep`
/// names a gap to keep, m.
pub fn nearby(rig: &Rig, margin: f64, keep: impl Fn(ShapeOwner, ShapeOwner) -> Option<f64>) -> Vec<Nearness> {
    let scene: &Scene = &rig.scene;
    let poses: Vec<Isometry3<f64>> =
        scene.robot_ids.links.iter().map(|link| rig.pose(link.body) * link.body_from_link).collect();
    let side = |owner: ShapeOwner, at: &Vector3<f64>| match owner {
        ShapeOwner::Robot(link) => Some((link, poses[link].inverse_transform_point(&Point3::from(*at)))),
        _ => None,
    };
    let contacts: Vec<Contact> = scene.model.contacts_at(&rig.state.qpos, margin).unwrap();
    let mut found = Vec::new();
    for contact in &contacts {
        let owners = [scene.owner(contact.shape_a), scene.owner(contact.shape_b)];
        if let Some(keep) = keep(owners[0], owners[1]) {
            let sides = owners.map(|owner| side(owner, &contact.position));
            found.push(Nearness { gap: contact.distance, keep, normal: contact.normal, sides, at: contact.position });
        }
    }
    found
}
