use fiatlux_world::{Scene, ShapeOwner};
use nalgebra::{Isometry3, Vector3};

use super::shapes::shapes;
use crate::look::Look;
use crate::mesh::{Detail, Frame, Mesh};
use crate::paint::Paint;

/// Half the side of the square of floor that is drawn, m; it fades out well before.
const FLOOR_HALF: f64 = 40.0;

/// The floor; its tiles are drawn by the shader.
pub(crate) fn floor(scene: &Scene, detail: Detail) -> Mesh {
    let mut mesh = Mesh::new(Frame::World, ShapeOwner::Floor, detail);
    for _ in shapes(scene, ShapeOwner::Floor) {
        let half = Vector3::new(FLOOR_HALF, FLOOR_HALF, 0.0);
        mesh.cuboid_face(&Isometry3::identity(), half, 2, 1.0, Paint::Floor);
    }
    mesh
}

/// The faces of walls and ceiling that look into the room. Seen from outside they face away, so that a view from there
/// looks through them.
///
/// The north has no wall, and the others end below the ceiling: people are shown a closed room.
pub(crate) fn walls(scene: &Scene, detail: Detail, look: Look) -> Mesh {
    let room = &scene.config.room;
    let middle = |range: [f64; 2]| (range[0] + range[1]) / 2.0;
    let center = Vector3::new(middle(room.zone_x), middle(room.zone_y), room.wall_top / 2.0);
    let mut mesh = Mesh::new(Frame::World, ShapeOwner::Room, detail);
    let is_closed = look == Look::Two && shapes(scene, ShapeOwner::Room).next().is_some();
    if is_closed {
        let half = Vector3::new((room.outer_x[1] - room.outer_x[0]) / 2.0, 0.0, room.ceiling_height / 2.0);
        let north = Isometry3::translation(middle(room.outer_x), room.outer_y[1], half.z);
        mesh.cuboid_face(&north, half, 1, -1.0, Paint::Wall);
    }
    for shape in shapes(scene, ShapeOwner::Room) {
        let Some(mut half_extents) = shape.geometry.as_cuboid() else { continue };
        let mut pose = shape.body_from_shape;
        let paint = if shape.name.contains("ceiling") { Paint::Ceiling } else { Paint::Wall };
        if is_closed && paint == Paint::Wall {
            // Up to the ceiling.
            let gap = (room.ceiling_height - pose.translation.z - half_extents.z) / 2.0;
            half_extents.z += gap;
            pose.translation.z += gap;
        }
        for axis in 0..3 {
            for side in [-1.0, 1.0] {
                let mut normal = Vector3::zeros();
                normal[axis] = side;
                let normal = pose.rotation * normal;
                let face = pose.translation.vector + normal * half_extents[axis];
                if normal.dot(&(center - face)) > 0.0 {
                    mesh.cuboid_face(&pose, half_extents, axis, side, paint);
                }
            }
        }
    }
    mesh
}
