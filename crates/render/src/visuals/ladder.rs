use fiatlux_dynamics::BodyId;
use fiatlux_rules::errand;
use fiatlux_world::{Scene, ShapeOwner};
use nalgebra::{Isometry3, Vector3};

use super::shapes::{self, frame_of, shapes};
use crate::mesh::{Detail, Frame, Mesh};
use crate::paint::Paint;

/// The ladder: aluminium rails, treads and platform with dark grips on them, rubber feet.
pub(crate) fn ladder(scene: &Scene, detail: Detail) -> Mesh {
    let frame = frame_of(scene, errand::LADDER);
    let mut mesh = Mesh::new(frame, ShapeOwner::LADDER, detail);
    for shape in shapes(scene, ShapeOwner::LADDER) {
        debug_assert!((shape.body == BodyId::WORLD) == (frame == Frame::World));
        let pose = &shape.body_from_shape;
        if let Some(half_extents) = shape.geometry.as_cuboid() {
            tread(&mut mesh, pose, half_extents);
            continue;
        }
        shapes::add(&mut mesh, pose, &shape.geometry, 0.0, 16, Paint::Aluminium);
        if let Some((radius, half_length)) = shape.geometry.as_capsule() {
            let ends = [-Vector3::z() * half_length, Vector3::z() * half_length];
            if shape.name.contains("rail") || shape.name.contains("leg") {
                // They start at the foot.
                let shoe = [ends[0], ends[0] + Vector3::z() * 0.05];
                mesh.bar(pose, shoe, [radius + 0.0015, radius + 0.005], 16, Paint::Rubber);
                let top = [ends[1] - Vector3::z() * 0.03, ends[1]];
                mesh.bar(pose, top, [radius + 0.003; 2], 16, Paint::Accent);
            }
            if shape.name.contains("guard") {
                let grip = half_length - 0.09;
                let ends = [-Vector3::z() * grip, Vector3::z() * grip];
                mesh.bar(pose, ends, [radius + 0.0015; 2], 16, Paint::Rubber);
            }
        }
    }
    mesh
}

/// A tread or the platform: an aluminium tray, and strips of grip along it, a millimetre proud.
fn tread(mesh: &mut Mesh, pose: &Isometry3<f64>, half: Vector3<f64>) {
    mesh.block(pose, half, 0.004, 1, 0.0, Paint::Aluminium);
    let (margin, gap, depth) = (0.010, 0.006, 0.004);
    let room = 2.0 * (half.y - margin);
    let strips = libm::round(room / 0.028).max(1.0);
    let width = room / strips - gap;
    for k in 0..strips as u32 {
        let y = -half.y + margin + (f64::from(k) + 0.5) * room / strips;
        let at = Isometry3::translation(0.0, y, half.z - depth + 0.001);
        mesh.cuboid(&(pose * at), Vector3::new(half.x - 0.015, width / 2.0, depth), Paint::Tread);
    }
}
