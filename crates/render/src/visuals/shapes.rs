//! Shapes of a scene by what they belong to, and a plain look for each.

use fiatlux_dynamics::{Geometry, ShapeSpec};
use fiatlux_world::{Scene, ShapeOwner};
use nalgebra::{Isometry3, Vector3};

use crate::mesh::{Frame, Mesh};
use crate::paint::Paint;

pub(super) fn shapes(scene: &Scene, owner: ShapeOwner) -> impl Iterator<Item = &ShapeSpec> {
    scene.model.shapes().iter().filter(move |shape| ShapeOwner::from_label(shape.label) == owner)
}

/// Where the shapes of a thing are given: with the thing, or in the world if it cannot move.
pub(super) fn frame_of(scene: &Scene, thing: usize) -> Frame {
    if scene.body(thing).is_some() { Frame::Thing(thing) } else { Frame::World }
}

/// Adds a shape as it is: edges of a box rounded by a share `round` of its least half extent, and `segments` around what is
/// round. A half-space is not drawn.
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

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use std::sync::Arc;

    use fiatlux_dynamics::Hull;

    use super::*;
    use crate::mesh::Detail;

    /// The triangles enclose the hull's volume, so all of them look outwards, as their normals do.
    #[test]
    fn a_hull_is_drawn_as_it_is() {
        let corners = [[0.1, 0.0, 0.0], [0.0, 0.2, 0.0], [0.0, 0.0, 0.3], [-0.1, -0.1, -0.1]].map(Vector3::from);
        let hull = Geometry::Hull(Arc::new(Hull::new("stone", &corners).unwrap()));
        let mut mesh = Mesh::new(Frame::World, ShapeOwner::Bench, Detail::Fine);
        add(&mut mesh, &Isometry3::translation(1.0, 2.0, 3.0), &hull, 0.0, 16, Paint::Tray);
        assert_eq!(mesh.triangles.len(), 4);
        let mut volume = 0.0;
        for triangle in &mesh.triangles {
            let [a, b, c] = triangle.vertices.map(|v| Vector3::from(mesh.positions[v as usize].map(f64::from)));
            volume += a.dot(&b.cross(&c)) / 6.0;
            let normal = Vector3::from(mesh.normals[triangle.vertices[0] as usize].map(f64::from));
            assert!(normal.dot(&(b - a).cross(&(c - a)).normalize()) > 0.999);
        }
        assert!((volume - hull.solid().volume).abs() < 1e-5, "{volume}");
    }
}
