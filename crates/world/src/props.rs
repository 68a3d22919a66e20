//! The things in the room, each as a list of convex parts in its own frame.

mod asset;
mod bench;
mod bulb;
mod crate_;
mod fixture;
mod ladder;
mod room;
mod sizes;
mod thing;

use fiatlux_dynamics::{BodyId, Geometry, Material, ModelBuilder, ModelError, ShapeSpec};
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};

pub(crate) use asset::asset;
pub(crate) use bench::bench;
pub(crate) use bulb::{bulb, bulb_body};
pub(crate) use crate_::crate_;
pub(crate) use fixture::fixture;
pub(crate) use ladder::{ladder, ladder_body};
pub(crate) use room::room;
pub(crate) use thing::{thing, thing_body};

pub use ladder::LadderPoints;
pub use sizes::PropSizes;

use crate::owner::ShapeOwner;

/// A convex part of a prop.
#[derive(Debug, Clone)]
pub struct Part {
    /// Its name in the prop.
    pub name: String,
    /// Pose of its shape in the prop's frame.
    pub prop_from_part: Isometry3<f64>,
    /// Geometry about its own frame.
    pub geometry: Geometry,
    /// Friction of its surface.
    pub material: Material,
}

impl Part {
    /// A box between two corners.
    fn cuboid(name: impl Into<String>, low: [f64; 3], high: [f64; 3], material: Material) -> Self {
        let (low, high) = (Vector3::from(low), Vector3::from(high));
        Self {
            name: name.into(),
            prop_from_part: Isometry3::from_parts(((low + high) / 2.0).into(), UnitQuaternion::identity()),
            geometry: Geometry::Cuboid { half_extents: (high - low) / 2.0 },
            material,
        }
    }

    /// A ball swept from one point to another; a ball where they are the same.
    fn swept_ball(
        name: impl Into<String>,
        from: Vector3<f64>,
        to: Vector3<f64>,
        radius: f64,
        material: Material,
    ) -> Self {
        let along = to - from;
        let length = along.norm();
        let (rotation, geometry) = if length > 0.0 {
            (rotation_of_z_to(&(along / length)), Geometry::Capsule { radius, half_length: length / 2.0 })
        } else {
            (UnitQuaternion::identity(), Geometry::Sphere { radius })
        };
        let prop_from_part = Isometry3::from_parts(Translation3::from((from + to) / 2.0), rotation);
        Self { name: name.into(), prop_from_part, geometry, material }
    }
}

/// The shortest turn that takes +z to a unit vector.
fn rotation_of_z_to(direction: &Vector3<f64>) -> UnitQuaternion<f64> {
    let w = 1.0 + direction.z;
    if w < 1e-12 {
        return UnitQuaternion::new_normalize(Quaternion::new(0.0, 1.0, 0.0, 0.0));
    }
    let axis = Vector3::z().cross(direction);
    UnitQuaternion::new_normalize(Quaternion::new(w, axis.x, axis.y, axis.z))
}

/// Four walls around a rectangle: the two across x, then the two across y between those.
fn walls(
    name: &str,
    center: [f64; 2],
    inner_half: [f64; 2],
    outer_half: [f64; 2],
    z: [f64; 2],
    material: Material,
) -> [Part; 4] {
    let [(xi, xo), (yi, yo)] = [(inner_half[0], outer_half[0]), (inner_half[1], outer_half[1])];
    [
        ("west", [-xo, -xi], [-yo, yo]),
        ("east", [xi, xo], [-yo, yo]),
        ("south", [-xi, xi], [-yo, -yi]),
        ("north", [-xi, xi], [yi, yo]),
    ]
    .map(|(side, x, y)| {
        let corner = |end: usize| [center[0] + x[end], center[1] + y[end], z[end]];
        Part::cuboid(format!("{name}_{side}"), corner(0), corner(1), material)
    })
}

/// Adds a prop's parts to a body as one cull group. `prefix` makes the names unique.
pub(crate) fn add_parts(
    builder: &mut ModelBuilder,
    parts: Vec<Part>,
    prefix: &str,
    body: BodyId,
    body_from_prop: &Isometry3<f64>,
    owner: ShapeOwner,
    cull_group: u16,
) -> Result<(), ModelError> {
    for part in parts {
        builder.add_shape(ShapeSpec {
            name: format!("{prefix}{}", part.name),
            body,
            body_from_shape: body_from_prop * part.prop_from_part,
            geometry: part.geometry,
            material: part.material,
            cull_group,
            label: owner.label(),
        })?;
    }
    Ok(())
}

/// The point of a part that reaches farthest along a direction of the prop's frame.
#[cfg(test)]
fn support(part: &Part, direction: &Vector3<f64>) -> Vector3<f64> {
    let local = part.prop_from_part.inverse_transform_vector(direction);
    (part.prop_from_part * nalgebra::Point3::from(part.geometry.support(&local))).coords
}
