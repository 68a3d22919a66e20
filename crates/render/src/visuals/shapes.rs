//! Shapes of a scene by what they belong to, and a plain look for each.

use fiatlux_dynamics::{Geometry, ShapeSpec};
use fiatlux_world::{Scene, ShapeOwner};
use nalgebra::{Isometry3, Vector3};

use crate::mesh::{Frame, Mesh};
use crate::paint::Paint;

/// The shapes of an owner.
pub(super) fn shapes(scene: &Scene, owner: ShapeOwner) -> impl Iterator<Item = &ShapeSpec> {
    scene.model.shapes().iter().filter(move |shape| ShapeOwner::from_label(shape.label) == owner)
}

/// Where the shapes of a thing are given: with the thing, or in the world if it cannot move.
pub(super) fn frame_of(scene: &Scene, thing: usize) -> Frame {
    if scene.body(thing).is_some() { Frame::Thing(thing) } else { Frame::World }
}

/// Adds a shape as it is, the edges of a box rounded by a share `round` of its least half extent, and `segments` around what is round. A half-space is not drawn.
pub(super) fn add(
    mesh: &mut Mesh,
    pose: &Isometry3<f64>,
    geometry: &Geometry,
    round: f64,
    segments: u32,
    paint: Paint,
) {
    match geometry {
        Geometry::HalfSpace => {}
        Geometry::Sphere { radius } => mesh.bar(pose, [Vector3::zeros(); 2], [*radius; 2], segments, paint),
        Geometry::Capsule { radius, half_length } => {
            let z = Vector3::z() * *half_length;
            mesh.bar(pose, [-z, z], [*radius; 2], segments, paint);
        }
        Geometry::Cuboid { half_extents } if round > 0.0 => {
            mesh.block(pose, *half_extents, round * half_extents.min(), 2, 0.0, paint);
        }
        Geometry::Cuboid { half_extents } => mesh.cuboid(pose, *half_extents, paint),
        Geometry::Hull(hull) => {
            for triangle in hull.triangles() {
                let corners = triangle.map(|vertex| hull.vertices()[vertex]);
                let normal = (corners[1] - corners[0]).cross(&(corners[2] - corners[0]));
                let corners = corners.map(|corner| mesh.vertex(pose, corner, normal));
                mesh.triangle(corners, paint);
            }
        }
    }
}
