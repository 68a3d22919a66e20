//! The outline by which rules measure a bulb: that of the shapes with which it collides.
//!
//! An outline drawn by hand would differ from them, and a bulb that lies free against a wall would reach into it.

use std::f64::consts::{PI, TAU};

use fiatlux_dynamics::{BodyId, Model};
use nalgebra::{Point3, Vector3};

/// Directions from the axis's one end to its other. What the shapes reach beyond the chords between their points is below 0.2 mm (the test below).
const DIRECTIONS: u32 = 96;
/// Directions around the axis: every 5 degrees, so that the six balls below a cap are among them.
const AROUND: u32 = 72;

/// The convex outline about +z of a body's shapes as (z, radius), z ascending, m: the farthest point in each direction. Empty for a
/// body without shapes.
pub(crate) fn silhouette(model: &Model, body: BodyId) -> Vec<[f64; 2]> {
    let shapes: Vec<_> = model.shapes().iter().filter(|shape| shape.body == body).collect();
    let farthest = |k: u32| {
        let angle = PI * f64::from(k) / f64::from(DIRECTIONS);
        let (along, across) = (-libm::cos(angle), libm::sin(angle));
        let around = (0..AROUND).map(|turn| TAU * f64::from(turn) / f64::from(AROUND));
        let directions = around.map(|turn| Vector3::new(across * libm::cos(turn), across * libm::sin(turn), along));
        let points = directions.flat_map(|direction| {
            shapes.iter().map(move |shape| {
                let local = shape.body_from_shape.inverse_transform_vector(&direction);
                let point = (shape.body_from_shape * Point3::from(shape.geometry.support(&local))).coords;
                (point.dot(&direction), point)
            })
        });
        let first = points.reduce(|best, other| if other.0 > best.0 { other } else { best });
        first.map(|(_, point)| [point.z, libm::hypot(point.x, point.y)])
    };
    (0..=DIRECTIONS).filter_map(farthest).collect()
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use std::sync::Arc;

    use fiatlux_robot::{GainSet, Robot};
    use fiatlux_rules::{Bulb, measure};
    use nalgebra::Isometry3;

    use super::*;
    use crate::{PropScale, Scene, SceneConfig, SceneKind, SceneSpec};

    /// In every direction the outline reaches as far as the shapes: never farther, and at most 0.2 mm less.
    #[test]
    fn the_outline_of_rules_is_that_of_the_shapes() {
        let robot = Arc::new(Robot::by_name("g1_inspire").unwrap());
        for factor in [1.0, 1.08] {
            let mut spec = SceneSpec::new(SceneKind::CoupledLadder, 3, robot.gains(GainSet::default()));
            spec.scale = PropScale { fresh_bulb: factor, ..PropScale::default() };
            let scene = Scene::build(&SceneConfig::default(), Arc::clone(&robot), spec).unwrap();
            for bulb in Bulb::ALL {
                let outline = &scene.geometry().bulbs[bulb as usize].outline;
                assert!(outline.windows(2).all(|pair| pair[0][0] <= pair[1][0]), "{outline:?}");
                let body = scene.body(bulb.thing()).unwrap();
                for k in 0..=1000 {
                    let (sine, cosine) = (libm::sin(PI * f64::from(k) / 1e3), libm::cos(PI * f64::from(k) / 1e3));
                    let direction = Vector3::new(sine, 0.0, cosine);
                    let own = scene.model.shapes().iter().filter(|shape| shape.body == body).map(|shape| {
                        let local = shape.body_from_shape.inverse_transform_vector(&direction);
                        let point = shape.body_from_shape * Point3::from(shape.geometry.support(&local));
                        point.coords.dot(&direction)
                    });
                    let shapes = own.fold(f64::NEG_INFINITY, f64::max);
                    let judged = measure::revolved_extent(outline, &Isometry3::identity(), &direction).max;
                    assert!((-2e-4..1e-9).contains(&(judged - shapes)), "{k}: {judged} and {shapes}");
                }
            }
        }
    }
}
