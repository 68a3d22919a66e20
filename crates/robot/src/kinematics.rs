//! Where the links are, without the engine: for controllers, checks and sensors.

use fiatlux_dynamics::check_array;
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};

use crate::{Joint, Link, Robot, RobotError};

impl Robot {
    /// Pose of every link, world, by link index, for joint angles `q` (rad, by joint index).
    ///
    /// # Errors
    /// A `q` of the wrong length or with an entry that is not finite.
    pub fn forward_kinematics(
        &self,
        q: &[f64],
        world_from_pelvis: &Isometry3<f64>,
    ) -> Result<Vec<Isometry3<f64>>, RobotError> {
        check_array("joint positions", q, self.joints.len())?;
        Ok(self.link_poses(q, world_from_pelvis))
    }

    /// Centre of mass, world, m.
    ///
    /// # Errors
    /// As [`Robot::forward_kinematics`].
    pub fn center_of_mass(&self, q: &[f64], world_from_pelvis: &Isometry3<f64>) -> Result<Vector3<f64>, RobotError> {
        let poses = self.forward_kinematics(q, world_from_pelvis)?;
        let moment: Vector3<f64> =
            self.links.iter().zip(&poses).map(|(link, pose)| link.mass * (pose * Point3::from(link.com)).coords).sum();
        Ok(moment / self.total_mass())
    }

    /// Efforts with which the drives hold up what hangs on their joints, N m, by joint index. Nothing but the pelvis is
    /// supported: for a leg on the ground they say nothing. `gravity` is in the pelvis frame, m/s^2.
    ///
    /// # Errors
    /// As [`Robot::forward_kinematics`], or a gravity that is not finite.
    pub fn holding_efforts(&self, q: &[f64], gravity: [f64; 3]) -> Result<Vec<f64>, RobotError> {
        check_array("gravity", &gravity, 3)?;
        let gravity = Vector3::from(gravity);
        let poses = self.forward_kinematics(q, &Isometry3::identity())?;
        // Mass and its first moment, of each link with all that hangs on it. Parents come before their children.
        let own =
            |(link, pose): (&Link, &Isometry3<f64>)| (link.mass, link.mass * (pose * Point3::from(link.com)).coords);
        let mut branches: Vec<(f64, Vector3<f64>)> = self.links.iter().zip(&poses).map(own).collect();
        for (index, link) in self.links.iter().enumerate().rev() {
            if let Some(parent) = link.parent {
                let (mass, moment) = branches[index];
                branches[parent].0 += mass;
                branches[parent].1 += moment;
            }
        }
        let effort = |joint: &Joint| {
            let (pose, (mass, moment)) = (&poses[joint.link], &branches[joint.link]);
            let arm = moment - pose.translation.vector * *mass;
            -(pose.rotation * joint.axis).dot(&arm.cross(&gravity))
        };
        Ok(self.joints.iter().map(effort).collect())
    }

    /// Height of the pelvis above a level floor that the lowest point of the soles touches, m, for joint angles `q` (rad, by
    /// joint index) and the pelvis turned so. Only the legs are computed, and nothing is allocated: a reset can afford it.
    ///
    /// # Errors
    /// As [`Robot::forward_kinematics`].
    pub fn height_on_soles(&self, q: &[f64], world_from_pelvis: &UnitQuaternion<f64>) -> Result<f64, RobotError> {
        check_array("joint positions", q, self.joints.len())?;
        Ok(self.sole_height(q, world_from_pelvis))
    }

    /// Height of the pelvis above the floor when the robot stands upright in posture q0, m.
    pub fn standing_height(&self) -> f64 {
        self.sole_height(&self.q0, &UnitQuaternion::identity())
    }

    fn sole_height(&self, q: &[f64], rotation: &UnitQuaternion<f64>) -> f64 {
        let world_from_pelvis = Isometry3::from_parts(Translation3::identity(), *rotation);
        let lowest = |&foot: &usize| {
            let world_from_foot = self.link_pose(foot, q, &world_from_pelvis);
            let soles = self.shapes.iter().filter(move |shape| shape.link == foot);
            soles.map(move |shape| shape.lowest_point(&world_from_foot)).fold(f64::INFINITY, f64::min)
        };
        -self.feet.iter().map(lowest).fold(f64::INFINITY, f64::min)
    }

    /// Pose of one link, by the joints above it.
    fn link_pose(&self, link: usize, q: &[f64], world_from_pelvis: &Isometry3<f64>) -> Isometry3<f64> {
        match self.links[link].parent {
            Some(parent) => self.links[link].below(&self.link_pose(parent, q, world_from_pelvis), q, &self.joints),
            None => *world_from_pelvis,
        }
    }

    pub(crate) fn link_poses(&self, q: &[f64], world_from_pelvis: &Isometry3<f64>) -> Vec<Isometry3<f64>> {
        let mut poses: Vec<Isometry3<f64>> = Vec::with_capacity(self.links.len());
        for link in &self.links {
            let Some(parent) = link.parent else {
                poses.push(*world_from_pelvis);
                continue;
            };
            poses.push(link.below(&poses[parent], q, &self.joints));
        }
        poses
    }
}

impl Link {
    /// Its pose, from that of its parent.
    fn below(&self, world_from_parent: &Isometry3<f64>, q: &[f64], joints: &[Joint]) -> Isometry3<f64> {
        let at_zero = world_from_parent * self.parent_from_link;
        match self.joint {
            Some(joint) => at_zero * UnitQuaternion::from_axis_angle(&joints[joint].axis, q[joint]),
            None => at_zero,
        }
    }
}

/// Pose from a position and fixed-axis roll, pitch and yaw.
pub(crate) fn pose(xyz: [f64; 3], rpy: [f64; 3]) -> Isometry3<f64> {
    let rotation = UnitQuaternion::from_euler_angles(rpy[0], rpy[1], rpy[2]);
    Isometry3::from_parts(Translation3::from(Vector3::from(xyz)), rotation)
}
