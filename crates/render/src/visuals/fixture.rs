use fiatlux_rules::errand;
use fiatlux_world::{Scene, ShapeOwner};
use nalgebra::{Isometry3, Vector3};

use super::shapes::shapes;
use crate::mesh::solids::Rim;
use crate::mesh::{Detail, Frame, Mesh};
use crate::paint::Paint;

/// The lamp's socket: a rounded housing, the collar with its bore and the brass sleeve in it, and the rod it hangs on.
pub(crate) fn fixture(scene: &Scene, detail: Detail) -> Mesh {
    let mut mesh = Mesh::new(Frame::World, ShapeOwner::FIXTURE, detail);
    let (config, seat) = (&scene.sizes.fixture, scene.sizes.seat_z);
    let pose = &scene.world_from(errand::FIXTURE);
    let (stop, mouth) = (seat + config.stop_height, seat + config.mouth_height);

    let half = Vector3::new(config.base_half[0], config.base_half[1], stop / 2.0);
    mesh.block(&(pose * Isometry3::translation(0.0, 0.0, stop / 2.0)), half, 0.012, 3, 0.0, Paint::Socket);

    let (outer, bore) = (config.collar_half, config.mouth_radius);
    let lip = 0.003;
    let collar = [
        Rim::new(stop, outer, [0.0, 1.0]),
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

    for shape in shapes(scene, ShapeOwner::FIXTURE) {
        let Some((radius, half_length)) = shape.geometry.as_capsule() else { continue };
        let (rod, z) = (&shape.body_from_shape, Vector3::z() * half_length);
        mesh.bar(rod, [-z, z], [radius; 2], 16, Paint::Steel);
        let ceiling = Vector3::new(pose.translation.x, pose.translation.y, scene.config.room.ceiling_height - 0.012);
        mesh.disc(&Isometry3::identity(), ceiling, &Vector3::z(), [0.055, 0.012], 32, Paint::Steel);
    }
    mesh
}
