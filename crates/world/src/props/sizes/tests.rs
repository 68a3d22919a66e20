#![allow(clippy::unwrap_used)]

use nalgebra::{Isometry3, Vector3};

use super::*;
use crate::props::{self, Part, support};

const SCALE: PropScale = PropScale { ladder: [1.05, 0.95, 1.1], socket: 0.9, fresh_bulb: 1.08 };

fn extent(parts: &[Part], axis: usize) -> [f64; 2] {
    let mut out = Vector3::zeros();
    out[axis] = 1.0;
    let reach = |sign: f64| parts.iter().map(|part| sign * support(part, &(sign * out))[axis]).fold(f64::MIN, f64::max);
    [-reach(-1.0), reach(1.0)]
}

fn assert_near(found: &[f64], expected: &[f64]) {
    assert_eq!(found.len(), expected.len());
    for (found, expected) in found.iter().zip(expected) {
        assert!((found - expected).abs() < 1e-12, "{found}, not {expected}");
    }
}

/// Factors of 1 change no bit, so that an unscaled scene is the published one.
#[test]
fn nominal_sizes_are_the_configs() {
    let config = SceneConfig::default();
    let sizes = PropSizes::new(&config, &PropScale::default()).unwrap();
    assert_eq!(sizes.ladder, config.ladder);
    assert_eq!(sizes.fixture, config.fixture);
    assert_eq!(sizes.seat_z, config.bulb.seat_z);
    assert_eq!(sizes.bulbs, [config.bulb.clone(), config.bulb]);
}

/// The ladder's extents, its treads and its platform are the published ones times the factors; its mass stays, and its
/// centre of mass is as high in it as before.
#[test]
fn a_ladder_is_scaled_along_each_axis() {
    let config = SceneConfig::default();
    let sizes = PropSizes::new(&config, &SCALE).unwrap();
    let parts = props::ladder(&sizes.ladder, &config.surfaces);
    assert_near(&extent(&parts, 0), &[-0.304 * 1.05, 0.304 * 1.05]);
    assert_near(&extent(&parts, 1), &[-0.4895 * 0.95, 0.4895 * 0.95]);
    assert_near(&extent(&parts, 2), &[0.0, 1.861 * 1.1]);
    let named = |name: &str| vec![parts.iter().find(|part| part.name == name).unwrap().clone()];
    for (name, top) in [("tread_0", 0.235), ("tread_1", 0.47), ("tread_2", 0.71), ("tread_3", 0.94)] {
        assert_near(&extent(&named(name), 2)[1..], &[top * 1.1]);
    }
    let platform = named("platform");
    assert_near(&extent(&platform, 0), &[-0.24 * 1.05, 0.24 * 1.05]);
    assert_near(&extent(&platform, 1), &[-0.10 * 0.95, 0.30 * 0.95]);
    assert_near(&extent(&platform, 2), &[1.15 * 1.1, 1.18 * 1.1]);
    let body = props::ladder_body(&sizes.ladder, &config.surfaces, Isometry3::identity()).unwrap();
    assert_near(&[body.mass, body.com.z], &[10.9, 0.8626 * 1.1]);
}

/// The bore is 18.7 mm and the housing 74 x 81 mm, times the factor; the rod is as thick as before.
#[test]
fn a_socket_is_scaled_as_a_whole() {
    let config = SceneConfig::default();
    let sizes = PropSizes::new(&config, &SCALE).unwrap();
    let mut parts = props::fixture(&sizes.fixture, sizes.seat_z, &config.surfaces, Some(1.9));
    assert_near(&extent(&[parts.pop().unwrap()], 0), &[-0.012, 0.012]);
    assert_near(&extent(&parts, 0), &[-0.074 * 0.9, 0.074 * 0.9]);
    assert_near(&extent(&parts, 1), &[-0.081 * 0.9, 0.081 * 0.9]);
    assert_near(&extent(&parts, 2), &[0.0, (0.036259 + 0.0342) * 0.9]);
    let facet = parts.into_iter().filter(|part| part.name == "sleeve_0").collect::<Vec<_>>();
    assert_near(&extent(&facet, 0), &[0.0187 * 0.9, 0.0215 * 0.9]);
    assert_near(&extent(&facet, 2), &[(0.036259 + 0.008) * 0.9, (0.036259 + 0.0281) * 0.9]);
}

/// The fresh bulb alone is scaled, about its origin; inertia goes with the square of the size.
#[test]
fn a_fresh_bulb_is_scaled_and_weighs_the_same() {
    let config = SceneConfig::default();
    let [old, fresh] = PropSizes::new(&config, &SCALE).unwrap().bulbs;
    assert_eq!(old, config.bulb);
    let [nominal, scaled] = [&old, &fresh].map(|bulb| props::bulb(bulb, &config.surfaces));
    for axis in 0..3 {
        assert_near(&extent(&scaled, axis), &extent(&nominal, axis).map(|reach| reach * 1.08));
    }
    assert_near(fresh.outline.as_flattened(), &old.outline.as_flattened().iter().map(|x| x * 1.08).collect::<Vec<_>>());
    let body = props::bulb_body(&fresh, "fresh", Isometry3::identity());
    assert_near(&[body.mass, body.com.z], &[0.035, 0.1242 * 1.08]);
    assert_near(&[body.inertia[(0, 0)], body.inertia[(2, 2)]], &[6.4e-5 * 1.08 * 1.08, 2.9e-5 * 1.08 * 1.08]);
}
