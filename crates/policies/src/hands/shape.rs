//! Shapes that the arm is kept clear of.

use fiatlux_dynamics::{BodyId, Geometry, Material, ShapeSpec};
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

/// Names of the shapes of a bulb, and of those into which it is put, begin with these.
pub(super) const BULB_NAME: &str = "bulb_";
pub(super) const SOCKET_NAME: &str = "socket_";

/// A shape, what carries it not yet decided.
#[derive(Clone)]
pub(super) struct Shape {
    name: String,
    pose: Isometry3<f64>,
    geometry: Geometry,
}

impl Shape {
    pub fn capsule(name: impl Into<String>, from: Vector3<f64>, to: Vector3<f64>, radius: f64) -> Self {
        let along = to - from;
        let rotation = UnitQuaternion::rotation_between(&Vector3::z(), &along)
            .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI));
        let pose = Isometry3::from_parts(Translation3::from((from + to) / 2.0), rotation);
        let geometry = if along.norm() > 0.0 {
            Geometry::Capsule { radius, half_length: along.norm() / 2.0 }
        } else {
            Geometry::Sphere { radius }
        };
        Self { name: name.into(), pose, geometry }
    }

    pub fn cuboid(name: &str, center: Vector3<f64>, half_extents: Vector3<f64>) -> Self {
        Self {
            name: name.into(),
            pose: Isometry3::translation(center.x, center.y, center.z),
            geometry: Geometry::Cuboid { half_extents },
        }
    }

    /// On a body, in whose frame the shape's own frame is at `pose`.
    pub fn on(self, body: BodyId, pose: &Isometry3<f64>, cull_group: u16) -> ShapeSpec {
        ShapeSpec {
            name: self.name,
            body,
            body_from_shape: pose * self.pose,
            geometry: self.geometry,
            material: Material::new(1.0, 0),
            cull_group,
            label: u32::MAX,
        }
    }
}

/// Obstacles of the arm: shapes with the pose of their frame, in the world and in the hand.
#[derive(Default)]
pub(super) struct Surroundings {
    pub in_world: Vec<(Shape, Isometry3<f64>)>,
    pub in_hand: Vec<(Shape, Isometry3<f64>)>,
    /// There is no room for a left arm that is held out.
    pub left_is_drawn_in: bool,
}
