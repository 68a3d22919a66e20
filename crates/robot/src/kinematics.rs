//! Where the links are, without the engine: for controllers, checks and sensors.

use fiatlux_dynamics::check_array;
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};

use crate::{Robot, RobotError};

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

    /// Height of the pelvis above the floor when the robot stands upright in posture q0, m.
    pub fn standing_height(&self) -> f64 {
        let poses = self.link_poses(&self.q0, &Isometry3::identity());
        let soles = self.shapes.iter().filter(|s| self.feet.contains(&s.link));
        -soles.map(|s| s.lowest_point(&poses[s.link])).fold(f64::INFINITY, f64::min)
    }

    pub(crate) fn link_poses(&self, q: &[f64], world_from_pelvis: &Isometry3<f64>) -> Vec<Isometry3<f64>> {
        let mut poses: Vec<Isometry3<f64>> = Vec::with_capacity(self.links.len());
        for link in &self.links {
            let Some(parent) = link.parent else {
                poses.push(*world_from_pelvis);
                continue;
            };
            let at_zero = poses[parent] * link.parent_from_link;
            poses.push(match link.joint {
                Some(joint) => at_zero * UnitQuaternion::from_axis_angle(&self.joints[joint].axis, q[joint]),
                None => at_zero,
            });
        }
        poses
    }
}

/// Pose from a position and fixed-axis roll, pitch and yaw.
pub(crate) fn pose(xyz: [f64; 3], rpy: [f64; 3]) -> Isometry3<f64> {
    let rotation = UnitQuaternion::from_euler_angles(rpy[0], rpy[1], rpy[2]);
    Isometry3::from_parts(Translation3::from(Vector3::from(xyz)), rotation)
}
