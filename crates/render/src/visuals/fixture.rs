use fiatlux_rules::errand;
use fiatlux_world::{Scene, ShapeOwner};
use nalgebra::{Isometry3, Vector3};

use super::shapes::shapes;
use crate::look::Look;
use crate::mesh::solids::Rim;
use crate::mesh::{Detail, Frame, Mesh};
use crate::paint::Paint;

/// The shade that people see: heights out of the socket and radii, m, from the back to its edge.
const SHADE: [[f64; 2]; 7] =
    [[-0.050, 0.016], [-0.046, 0.026], [-0.006, 0.038], [0.002, 0.062], [0.012, 0.100], [0.032, 0.134], [0.058, 0.150]];
const SHEET: f64 = 0.003;
/// Length of the arm behind a lamp that looks sideways, up to the rod it hangs on, m.
const ARM: f64 = 0.13;

/// The lamp's socket: a rounded housing, the collar with its bore and the brass sleeve in it, and the rod it hangs on. People see
/// a shade in place of the housing, and a lamp that looks sideways on an arm.
pub(crate) fn fixture(scene: &Scene, detail: Detail, look: Look) -> Mesh {
    let mut mesh = Mesh::new(Frame::World, ShapeOwner::FIXTURE, detail);
    let (config, seat) = (&scene.sizes.fixture, scene.sizes.seat_z);
    let pose = &scene.world_from(errand::FIXTURE);
    let (stop, mouth) = (seat + config.stop_height, seat + config.mouth_height);

    let half = Vector3::new(config.base_half[0], config.base_half[1], stop / 2.0);
    let (outer, bore) = (config.collar_half, config.mouth_radius);
    let foot = match look {
        Look::One => {
            mesh.block(&(pose * Isometry3::translation(0.0, 0.0, stop / 2.0)), half, 0.012, 3, 0.0, Paint::Socket);
            stop
        }
        Look::Two => {
            shade(&mut mesh, pose);
            0.0
        }
    };
    let lip = 0.003;
    let collar = [
        Rim::new(foot, outer, [0.0, 1.0]),
        Rim::new(mouth - lip, outer, [0.0, 1.0]),
        Rim::new(mouth, outer - lip, [1.0, 0.0]),
        Rim::new(mouth, bore, [1.0, 0.0]),
    ];
    mesh.revolve(pose, &collar, 32, Paint::Shell);
    let inner = config.sleeve_radius[0];
    let sleeve = [
        Rim::new(mouth, bore, [0.0, -1.0]),
        Rim::new(seat + config.sleeve_height[1], inner, [0.0, -1.0]),
        Rim::new(stop, inner, [0.0, -1.0]),
    ];
    mesh.revolve(pose, &sleeve, 32, Paint::Brass);
    let bottom = [Rim::new(stop + 0.0005, inner, [1.0, 0.0]), Rim::new(stop + 0.0005, 0.0, [1.0, 0.0])];
    mesh.revolve(pose, &bottom, 32, Paint::Tip);

    let mut top = pose.translation.vector;
    top.z = scene.config.room.ceiling_height - 0.012;
    let rosette = |mesh: &mut Mesh, top: Vector3<f64>| {
        mesh.disc(&Isometry3::identity(), top, &Vector3::z(), [0.055, 0.012], 32, Paint::Steel);
    };
    for shape in shapes(scene, ShapeOwner::FIXTURE) {
        let Some((radius, half_length)) = shape.geometry.as_capsule() else { continue };
        let (rod, z) = (&shape.body_from_shape, Vector3::z() * half_length);
        mesh.bar(rod, [-z, z], [radius; 2], 16, Paint::Steel);
        rosette(&mut mesh, top);
    }
    let out = pose.rotation * Vector3::z();
    if look == Look::Two && out.z.abs() < 0.5 {
        let (back, elbow) = (pose.translation.vector, pose.translation.vector - ARM * out);
        (top.x, top.y) = (elbow.x, elbow.y);
        for ends in [[back, elbow], [elbow, top]] {
            mesh.bar(&Isometry3::identity(), ends, [config.rod_radius; 2], 16, Paint::Steel);
        }
        rosette(&mut mesh, top);
    }
    mesh
}

/// A dish of enamelled sheet, dark outside and white inside.
fn shade(mesh: &mut Mesh, pose: &Isometry3<f64>) {
    let rim = |at: usize, side: f64| {
        let [[z0, r0], [z1, r1]] = [SHADE[at.saturating_sub(1)], SHADE[(at + 1).min(SHADE.len() - 1)]];
        let normal = [side * (r0 - r1), side * (z1 - z0)];
        let length = libm::hypot(normal[0], normal[1]);
        let inwards = if side < 0.0 { SHEET / length } else { 0.0 };
        Rim::new(SHADE[at][0] + inwards * normal[0], SHADE[at][1] + inwards * normal[1], normal)
    };
    let [[back, neck], ..] = SHADE;
    let mut outside = vec![Rim::new(back, 0.0, [-1.0, 0.0]), Rim::new(back, neck, [-1.0, 0.0])];
    outside.extend((0..SHADE.len()).map(|at| rim(at, 1.0)));
    mesh.revolve(pose, &outside, 40, Paint::Graphite);
    let last = SHADE.len() - 1;
    let edge = [rim(last, 1.0), rim(last, -1.0)].map(|rim| Rim { normal: [1.0, 0.0], ..rim });
    mesh.revolve(pose, &edge, 40, Paint::Shell);
    let inside: Vec<Rim> = (2..SHADE.len()).rev().map(|at| rim(at, -1.0)).collect();
    mesh.revolve(pose, &inside, 40, Paint::Shell);
}
