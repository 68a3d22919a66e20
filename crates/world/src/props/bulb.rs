use std::f64::consts::TAU;

use fiatlux_dynamics::{BodyId, BodySpec, Joint};
use nalgebra::{Isometry3, Matrix3, Vector3};

use super::Part;
use crate::config::{BulbConfig, Surfaces};

pub(crate) fn bulb_body(config: &BulbConfig, name: &str, world_from_bulb: Isometry3<f64>) -> BodySpec {
    let (across, along) = (config.transverse_inertia, config.axial_inertia);
    BodySpec {
        name: name.into(),
        parent: BodyId::WORLD,
        parent_from_body: world_from_bulb,
        joint: Joint::Free,
        mass: config.mass,
        com: Vector3::new(0.0, 0.0, config.com_z),
        inertia: Matrix3::from_diagonal(&Vector3::new(across, across, along)),
    }
}

/// The solids along the axis, and the ring of small balls on which a bulb can stand.
pub(crate) fn bulb(config: &BulbConfig, surfaces: &Surfaces) -> Vec<Part> {
    let material = surfaces.bulb.material();
    let axial = |z: f64| Vector3::new(0.0, 0.0, z);
    let mut parts: Vec<Part> = config
        .solids
        .iter()
        .enumerate()
        .map(|(i, &[from, to, radius])| {
            Part::swept_ball(format!("solid_{i}"), axial(from), axial(to), radius, material)
        })
        .collect();
    for ball in 0..config.cap_balls {
        let angle = TAU * f64::from(ball) / f64::from(config.cap_balls);
        let (ring, radius) = (config.cap_ring_radius, config.cap_ball_radius);
        let center = Vector3::new(ring * libm::cos(angle), ring * libm::sin(angle), config.seat_z + radius);
        parts.push(Part::swept_ball(format!("cap_{ball}"), center, center, radius, material));
    }
    parts
}

#[cfg(test)]
mod tests;
