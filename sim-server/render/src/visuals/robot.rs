use fiatlux_dynamics::Geometry;
use fiatlux_robot::{Robot, Shape};
use fiatlux_world::ShapeOwner;
use nalgebra::{Isometry3, Vector3};

use super::g1;
use crate::mesh::{Detail, Frame, Mesh};
use crate::paint::Paint;

/// One mesh a link. A link of the G1 that has a look of its own gets that; any other is drawn as its collision shapes.
pub(crate) fn links(robot: &Robot, detail: Detail) -> Vec<Mesh> {
    let fingers = |link: usize| robot.hand_links().contains(&link);
    robot
        .links()
        .iter()
        .enumerate()
        .map(|(index, link)| {
            let mut mesh = Mesh::new(Frame::Link(index), ShapeOwner::Robot(index), detail);
            if !g1::dress(&mut mesh, &link.name) {
                let paint = if fingers(index) { Paint::Hand } else { Paint::Shell };
                for shape in robot.shapes().iter().filter(|shape| shape.link == index) {
                    add(&mut mesh, shape, paint);
                }
            }
            mesh
        })
        .collect()
}

fn add(mesh: &mut Mesh, shape: &Shape, paint: Paint) {
    let pose: &Isometry3<f64> = &shape.link_from_shape;
    match shape.geometry {
        Geometry::Capsule { radius, half_length } => {
            let segments = if radius < 0.015 { 10 } else { 20 };
            let z = Vector3::z() * half_length;
            mesh.bar(pose, [-z, z], [radius; 2], segments, paint);
        }
        Geometry::Sphere { radius } => mesh.bar(pose, [Vector3::zeros(); 2], [radius; 2], 20, paint),
        Geometry::Cuboid { half_extents } => {
            mesh.block(pose, half_extents, 0.4 * half_extents.min(), 2, 0.0, paint);
        }
        Geometry::HalfSpace => {}
    }
}
