use std::f64::consts::TAU;

use fiatlux_dynamics::Geometry;
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

use super::{Part, walls};
use crate::config::{FixtureConfig, Surfaces};

/// Housing (its front is the stop for the plug), collar, guide sleeve, and the rod where a length is given. The frame is
/// the socket's: +z points out of it.
pub(crate) fn fixture(config: &FixtureConfig, seat_z: f64, surfaces: &Surfaces, rod_length: Option<f64>) -> Vec<Part> {
    let material = surfaces.fixture.material();
    let [x, y] = config.base_half;
    let (stop, mouth) = (seat_z + config.stop_height, seat_z + config.mouth_height);
    let mut parts = vec![Part::cuboid("base", [-x, -y, 0.0], [x, y, stop], material)];
    let (bore, collar) = ([config.mouth_radius; 2], [config.collar_half; 2]);
    parts.extend(walls("collar", [0.0; 2], bore, collar, [stop, mouth], material));
    parts.extend(sleeve(config, seat_z, surfaces));
    if let Some(length) = rod_length {
        let (from, to) = (Vector3::z() * -config.rod_radius, Vector3::z() * -length);
        parts.push(Part::swept_ball("rod", from, to, config.rod_radius, material));
    }
    parts
}

/// Boxes around the bore. Their inner faces touch the sleeve's inner circle from outside, so the bore is nowhere narrower.
fn sleeve(config: &FixtureConfig, seat_z: f64, surfaces: &Surfaces) -> impl Iterator<Item = Part> {
    let [inner, outer] = config.sleeve_radius;
    let [low, high] = config.sleeve_height.map(|z| seat_z + z);
    let step = TAU / f64::from(config.sleeve_facets);
    let half_extents = Vector3::new((outer - inner) / 2.0, inner * libm::tan(step / 2.0), (high - low) / 2.0);
    let material = surfaces.sleeve.material();
    (0..config.sleeve_facets).map(move |facet| {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), f64::from(facet) * step);
        let center = turn * Vector3::new((inner + outer) / 2.0, 0.0, (low + high) / 2.0);
        Part {
            name: format!("sleeve_{facet}"),
            prop_from_part: Isometry3::from_parts(Translation3::from(center), turn),
            geometry: Geometry::Cuboid { half_extents },
            material,
        }
    })
}
