#![allow(clippy::unwrap_used)]

use fiatlux_dynamics::Geometry;
use parry3d_f64::mass_properties::MassProperties;
use parry3d_f64::shape::{Capsule, Cuboid, Shape};

use super::*;
use crate::SceneConfig;
use crate::props::support;

fn body() -> (SceneConfig, BodySpec) {
    let config = SceneConfig::default();
    let body = ladder_body(&config.ladder, &config.surfaces, Isometry3::identity()).unwrap();
    (config, body)
}

#[test]
fn has_the_published_extents_and_feet() {
    let config = SceneConfig::default();
    let parts = ladder(&config.ladder, &config.surfaces);
    let reach = |direction: Vector3<f64>| {
        parts.iter().map(|part| support(part, &direction).dot(&direction)).fold(f64::NEG_INFINITY, f64::max)
    };
    for (direction, expected) in [
        (Vector3::x(), 0.304),
        (-Vector3::x(), 0.304),
        (Vector3::y(), 0.4895),
        (-Vector3::y(), 0.4895),
        (Vector3::z(), 1.861),
        (-Vector3::z(), 0.0),
    ] {
        assert!((reach(direction) - expected).abs() < 1e-12, "{direction}: {}", reach(direction));
    }
    // Each foot point is a lowest point of some part.
    for foot in LadderPoints::new(&config.ladder).feet {
        assert!(parts.iter().any(|part| (support(part, &-Vector3::z()) - foot).norm() < 1e-9), "{foot}");
    }
}

#[test]
fn has_the_published_mass_and_center() {
    let (_, body) = body();
    assert_eq!(body.mass, 10.9);
    assert!((body.com.z - 0.8626).abs() < 1e-12 && body.com.x.abs() < 1e-12, "{}", body.com);
    // It stands: the centre of mass is well inside the footprint.
    assert!(body.com.y.abs() < 0.1, "{}", body.com.y);
}

/// Moments of the parts against those of the collision library.
#[test]
fn moments_agree_with_parry() {
    let config = SceneConfig::default();
    for part in ladder(&config.ladder, &config.surfaces) {
        let solid = part.geometry.solid();
        let (volume, moments) = (solid.volume, solid.inertia.diagonal());
        let reference: MassProperties = match part.geometry {
            Geometry::Capsule { radius, half_length } => Capsule::new_z(half_length, radius).mass_properties(1.0),
            Geometry::Cuboid { half_extents: h } => {
                Cuboid::new(parry3d_f64::math::Vector::new(h.x, h.y, h.z)).mass_properties(1.0)
            }
            _ => unreachable!("the ladder has capsules and boxes"),
        };
        assert!((volume / reference.mass() - 1.0).abs() < 1e-9, "{}", part.name);
        let matrix = reference.reconstruct_inertia_matrix();
        let diagonal = [matrix.col(0)[0], matrix.col(1)[1], matrix.col(2)[2]];
        for axis in 0..3 {
            assert!((moments[axis] / diagonal[axis] - 1.0).abs() < 1e-9, "{}: {moments} {diagonal:?}", part.name);
        }
    }
}

/// The inertia lies between that of a box of the ladder's size filled evenly and that of all mass in its corners.
#[test]
fn inertia_is_plausible() {
    let (config, body) = body();
    let square = Vector3::from(config.ladder.size).map(|s| s * s / 4.0);
    let corners = Vector3::new(square.y + square.z, square.x + square.z, square.x + square.y) * body.mass;
    for axis in 0..3 {
        let moment = body.inertia[(axis, axis)];
        assert!(moment > corners[axis] / 8.0 && moment < corners[axis], "{axis}: {moment} of {}", corners[axis]);
    }
}

#[test]
fn a_center_of_mass_out_of_reach_is_refused() {
    let config = SceneConfig::from_toml("[ladder]\ncom_z = 0.1").unwrap();
    let error = ladder_body(&config.ladder, &config.surfaces, Isometry3::identity()).unwrap_err();
    assert!(error.to_string().contains("ladder.com_z is 0.1; it must be between"), "{error}");
}
