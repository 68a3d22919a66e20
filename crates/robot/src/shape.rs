use std::f64::consts::PI;

use fiatlux_dynamics::{Geometry, Material};
use nalgebra::{Isometry3, UnitQuaternion, Vector3};

/// A collision shape of a link.
#[derive(Debug, Clone, PartialEq)]
pub struct Shape {
    /// Name of the shape, which no other shape of the robot has.
    pub name: String,
    /// Index of the link that carries it.
    pub link: usize,
    /// Pose in that link.
    pub link_from_shape: Isometry3<f64>,
    /// Sphere, capsule or box.
    pub geometry: Geometry,
    /// Its surface: an index into [`crate::Robot::surfaces`].
    pub surface: usize,
    /// Number of its cull group, from 0.
    pub group: u16,
}

/// Surface of a link's shapes.
#[derive(Debug, Clone, PartialEq)]
pub struct Surface {
    /// Name in the file.
    pub name: String,
    /// Coefficient and priority that the engine uses.
    pub material: Material,
    /// Static coefficient of the source, recorded only.
    pub static_friction: f64,
}

impl Shape {
    /// Where a capsule or a box that lies along its link ends, in the frame of the shape; z points out. A box ends away from the
    /// link's joint, along its longest side.
    pub(crate) fn far_end(&self) -> Option<Isometry3<f64>> {
        if let Some((radius, half_length)) = self.geometry.as_capsule() {
            return Some(Isometry3::translation(0.0, 0.0, half_length + radius));
        }
        let half = self.geometry.as_cuboid()?;
        let axis = half.imax();
        let joint = self.link_from_shape.inverse().translation.vector;
        let out = Vector3::ith(axis, -joint[axis].signum());
        let turn = UnitQuaternion::rotation_between(&Vector3::z(), &out)
            .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), PI));
        Some(Isometry3::from_parts((out * half[axis]).into(), turn))
    }

    /// Height of the shape's lowest point, m.
    pub(crate) fn lowest_point(&self, world_from_link: &Isometry3<f64>) -> f64 {
        let world_from_shape = world_from_link * self.link_from_shape;
        let down = world_from_shape.inverse_transform_vector(&-Vector3::z());
        world_from_shape.translation.z - self.geometry.reach(&down)
    }
}
