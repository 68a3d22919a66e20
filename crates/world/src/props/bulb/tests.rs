#![allow(clippy::unwrap_used)]

use fiatlux_dynamics::Geometry;

use super::*;
use crate::SceneConfig;

/// Distance of a point of the half plane (z, r) from the union of the parts, negative inside.
fn distance(parts: &[Part], z: f64, r: f64) -> f64 {
    let point = Vector3::new(r, 0.0, z);
    let to_part = |part: &Part| {
        let center = part.prop_from_part.translation.vector;
        match part.geometry {
            Geometry::Sphere { radius } => (point - center).norm() - radius,
            Geometry::Capsule { radius, half_length } => {
                let along = (z - center.z).clamp(-half_length, half_length);
                (point - center - Vector3::z() * along).norm() - radius
            }
            _ => unreachable!("a bulb has balls and capsules"),
        }
    };
    parts.iter().map(to_part).fold(f64::INFINITY, f64::min)
}

/// Collision follows what is drawn: within 1.6 mm on glass and neck, 0.4 mm on the plug. Above its last but one point the outline is a chord through a dome, so only its end counts there.
#[test]
fn collision_follows_the_outline() {
    let config = SceneConfig::default().bulb;
    let parts = bulb(&config, &SceneConfig::default().surfaces);
    let mut worst = [0.0_f64; 2];
    for pair in config.outline.windows(2).take(config.outline.len() - 2) {
        for k in 0..200 {
            let t = f64::from(k) / 200.0;
            let [z, r] = [0, 1].map(|i| pair[0][i] + t * (pair[1][i] - pair[0][i]));
            let region = usize::from(z < 0.078);
            worst[region] = worst[region].max(distance(&parts, z, r).abs());
        }
    }
    assert!(worst[0] < 1.6e-3, "glass and neck: {} m", worst[0]);
    assert!(worst[1] < 2.2e-3, "plug and its shoulder: {} m", worst[1]);
    // Nowhere does it look much larger than it is.
    let drawn = config.outline.iter().map(|&[z, r]| distance(&parts, z, r)).fold(f64::NEG_INFINITY, f64::max);
    assert!(drawn < 1e-3, "{drawn} m");
    let [tip, _] = config.outline[config.outline.len() - 1];
    assert!(distance(&parts, tip, 0.0).abs() < 1e-4);
    // It stands on its cap, and lies at the published height.
    assert!(distance(&parts, config.seat_z, config.cap_ring_radius).abs() < 1e-12);
    let widest = config.solids.iter().map(|s| s[2]).fold(0.0, f64::max);
    assert!((widest - config.lying_height).abs() < 1e-4);
}

/// The published outline as a thin shell (trapezoids, each band a cone) has the given centre of mass, and brackets the inertia.
#[test]
fn mass_agrees_with_a_thin_shell() {
    let config = SceneConfig::default().bulb;
    let glass = config.outline.iter().filter(|point| point[0] > 0.08).copied();
    let published = [[0.036259, 0.00759], [0.04583, 0.02026], [0.07436, 0.02196]].into_iter().chain(glass);
    let published: Vec<[f64; 2]> = published.collect();
    let (mut area, mut first, mut axial, mut second) = (0.0, 0.0, 0.0, 0.0);
    for pair in published.windows(2) {
        let n = 1000;
        let length = libm::hypot(pair[1][0] - pair[0][0], pair[1][1] - pair[0][1]) / f64::from(n);
        for k in 0..n {
            let t = (f64::from(k) + 0.5) / f64::from(n);
            let [z, r] = [0, 1].map(|i| pair[0][i] + t * (pair[1][i] - pair[0][i]));
            let band = TAU * r * length;
            area += band;
            first += band * z;
            axial += band * r * r;
            second += band * (r * r / 2.0 + z * z);
        }
    }
    let com = first / area;
    assert!((com - config.com_z).abs() < 1e-4, "{com}");
    let (axial, across) = (config.mass * axial / area, config.mass * (second / area - com * com));
    assert!((axial / config.axial_inertia - 1.0).abs() < 0.1, "{axial}");
    assert!((across / config.transverse_inertia - 1.0).abs() < 0.3, "{across}");
}
