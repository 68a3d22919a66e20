use std::sync::Arc;

use fiatlux_robot::{Robot, Shape};
use fiatlux_world::ShapeOwner;

use super::{g1, shapes};
use crate::RobotMeshes;
use crate::look::Look;
use crate::mesh::{Detail, Frame, Mesh};
use crate::paint::Paint;

/// One mesh a link: the user's own where there is one. A link of the G1 that has a look of its own gets that; any other is
/// drawn as its collision shapes.
pub(crate) fn links(robot: &Robot, meshes: Option<&RobotMeshes>, detail: Detail, look: Look) -> Vec<Arc<Mesh>> {
    let link = |link: usize| match meshes.and_then(|meshes| meshes.get(link, detail)) {
        Some(mesh) => mesh,
        None if meshes.is_some_and(|meshes| meshes.covers(link, robot)) => {
            Arc::new(Mesh::new(Frame::Link(link), ShapeOwner::Robot(link), detail))
        }
        None => Arc::new(own(robot, link, detail, look).finished()),
    };
    (0..robot.links().len()).map(link).collect()
}

fn own(robot: &Robot, link: usize, detail: Detail, look: Look) -> Mesh {
    let mut mesh = Mesh::new(Frame::Link(link), ShapeOwner::Robot(link), detail);
    if !g1::dress(&mut mesh, &robot.links()[link].name, look) {
        let paint = if robot.hand_links().contains(&link) { Paint::Hand } else { Paint::Shell };
        for shape in robot.shapes().iter().filter(|shape| shape.link == link) {
            add(&mut mesh, shape, paint);
        }
    }
    mesh
}

fn add(mesh: &mut Mesh, shape: &Shape, paint: Paint) {
    let is_thin = shape.geometry.as_capsule().is_some_and(|(radius, _)| radius < 0.015);
    let segments = if is_thin { 10 } else { 20 };
    shapes::add(mesh, &shape.link_from_shape, &shape.geometry, 0.4, segments, paint);
}
