//! Where one link is, without all the others.

use fiatlux_robot::Robot;
use fiatlux_rules::Row;
use nalgebra::{Isometry3, UnitQuaternion};

/// Pose of a link in a row, world. `link` is an index into [`Robot::links`].
///
/// # Panics
/// If the robot has no such link.
pub fn world_from_link(robot: &Robot, link: usize, row: &Row) -> Isometry3<f64> {
    let mut above_from_link = Isometry3::identity();
    let mut at = &robot.links()[link];
    while let Some(parent) = at.parent {
        if let Some(joint) = at.joint {
            // A robot of a scene has no more joints than a row.
            let angle = row.joint_position.get(joint).copied().unwrap_or_default();
            above_from_link = UnitQuaternion::from_axis_angle(&robot.joints()[joint].axis, angle) * above_from_link;
        }
        above_from_link = at.parent_from_link * above_from_link;
        at = &robot.links()[parent];
    }
    row.robot.pose * above_from_link
}
