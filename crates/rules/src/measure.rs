//! Geometry derived from poses. These are only measurements: the rulebook decides what they mean.

use std::f64::consts::{PI, TAU};

use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector2, Vector3};

/// Acceleration of free fall, m/s^2, along -z.
pub const GRAVITY: f64 = 9.81;

/// Angle between a body's z axis and the vertical, rad.
pub fn tilt(world_from_body: &Isometry3<f64>) -> f64 {
    let z = world_from_body.rotation * Vector3::z();
    libm::atan2(libm::sqrt(z.x * z.x + z.y * z.y), z.z)
}

/// The largest of numbers that are zero or above, or 0; NaN is ignored.
pub fn largest(numbers: impl IntoIterator<Item = f64>) -> f64 {
    // Cheaper than `f64::max`, which looks for NaN on both sides.
    numbers.into_iter().fold(0.0, |largest, number| if number > largest { number } else { largest })
}

/// The largest length of vectors, or 0; NaN is ignored.
pub fn largest_norm(vectors: &[Vector3<f64>]) -> f64 {
    // The root of the largest square is the largest root, to the bit.
    libm::sqrt(largest(vectors.iter().map(Vector3::norm_squared)))
}

/// Angle between two directions, rad.
pub fn angle_between(a: &Vector3<f64>, b: &Vector3<f64>) -> f64 {
    libm::atan2(a.cross(b).norm(), a.dot(b))
}

/// Heading of a body's x axis about the vertical, rad.
pub fn yaw(rotation: &UnitQuaternion<f64>) -> f64 {
    let x = rotation * Vector3::x();
    libm::atan2(x.y, x.x)
}

/// Direction from one place to another, rad.
pub fn bearing(from: &Vector2<f64>, to: &Vector2<f64>) -> f64 {
    libm::atan2(to.y - from.y, to.x - from.x)
}

/// The angle's equal in [-pi, pi).
pub fn wrap_angle(angle: f64) -> f64 {
    let wrapped = angle - TAU * libm::floor((angle + PI) / TAU);
    // Rounding can land on the open end.
    if wrapped >= PI { wrapped - TAU } else { wrapped }
}

/// Angle about the vertical from a body's heading to a point, rad, in [-pi, pi).
pub fn facing_angle(world_from_body: &Isometry3<f64>, target: &Vector3<f64>) -> f64 {
    let position = world_from_body.translation.vector;
    wrap_angle(bearing(&position.xy(), &target.xy()) - yaw(&world_from_body.rotation))
}

/// Distance between two points over the ground: without their difference in z, m.
pub fn horizontal_distance(a: &Vector3<f64>, b: &Vector3<f64>) -> f64 {
    (a - b).xy().norm()
}

/// A point of a body in the world: plug point of a bulb, seat point of a socket, top point of a ladder.
pub fn world_point(world_from_body: &Isometry3<f64>, body_point: &Vector3<f64>) -> Vector3<f64> {
    (world_from_body * Point3::from(*body_point)).coords
}

/// Heights of points of a body, such as a ladder's feet, m.
pub fn heights<const N: usize>(world_from_body: &Isometry3<f64>, body_points: &[Vector3<f64>; N]) -> [f64; N] {
    body_points.map(|point| world_point(world_from_body, &point).z)
}

/// Horizontal distance from a point to a rectangle that a body carries, centred on its origin, m; 0 inside.
pub fn footprint_distance(world_from_body: &Isometry3<f64>, half: &[f64; 2], point: &Vector3<f64>) -> f64 {
    let local = world_from_body.inverse_transform_point(&Point3::from(*point));
    // Unlike `max`, this keeps NaN.
    let outside = |value: f64, half: f64| if value.abs() < half { 0.0 } else { value.abs() - half };
    libm::hypot(outside(local.x, half[0]), outside(local.y, half[1]))
}

/// Least and greatest value along an axis (a unit vector), m.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Extent {
    /// Least value along the axis, m.
    pub min: f64,
    /// Greatest value along the axis, m.
    pub max: f64,
}

impl Extent {
    /// Greatest distance from zero, m.
    pub fn reach(&self) -> f64 {
        self.min.abs().max(self.max.abs())
    }
}

/// Extent along `axis` of a solid of revolution about its +z, with the outline given as (z, radius): a circle of radius
/// r at height z spans `z c - r s` to `z c + r s`, where c and s are cosine and sine of the angle between the axes.
pub fn revolved_extent(outline: &[[f64; 2]], frame_from_solid: &Isometry3<f64>, axis: &Vector3<f64>) -> Extent {
    let along = frame_from_solid.rotation * Vector3::z();
    let (c, s) = (along.dot(axis), along.cross(axis).norm());
    let origin = frame_from_solid.translation.vector.dot(axis);
    outline.iter().fold(Extent { min: f64::INFINITY, max: f64::NEG_INFINITY }, |extent, [z, radius]| Extent {
        min: extent.min.min(origin + z * c - radius * s),
        max: extent.max.max(origin + z * c + radius * s),
    })
}

/// Height of the lowest point of a solid of revolution, m.
pub fn lowest_point(outline: &[[f64; 2]], world_from_solid: &Isometry3<f64>) -> f64 {
    revolved_extent(outline, world_from_solid, &Vector3::z()).min
}

/// Extents of a solid of revolution along the axes of another body, such as of a bulb in the crate's frame, m.
pub fn extents_in(
    outline: &[[f64; 2]],
    world_from_solid: &Isometry3<f64>,
    world_from_frame: &Isometry3<f64>,
) -> [Extent; 3] {
    let frame_from_solid = world_from_frame.inverse() * world_from_solid;
    [Vector3::x(), Vector3::y(), Vector3::z()].map(|axis| revolved_extent(outline, &frame_from_solid, &axis))
}

#[cfg(test)]
mod tests {
    use std::f64::consts::{FRAC_PI_2, FRAC_PI_4};

    use nalgebra::Translation3;

    use super::*;

    fn pose(x: f64, y: f64, z: f64, axis: Vector3<f64>) -> Isometry3<f64> {
        Isometry3::from_parts(Translation3::new(x, y, z), UnitQuaternion::from_scaled_axis(axis))
    }

    #[test]
    fn angles() {
        assert!((tilt(&pose(0.0, 0.0, 0.0, Vector3::x() * 1e-9)) - 1e-9).abs() < 1e-20);
        assert!((tilt(&pose(0.0, 0.0, 0.0, Vector3::new(0.0, 2.5, 0.0))) - 2.5).abs() < 1e-12);
        assert_eq!(tilt(&pose(1.0, 2.0, 3.0, Vector3::z())), 0.0);
        for (angle, expected) in [(0.0, 0.0), (PI, -PI), (-PI, -PI), (3.5 * TAU + 0.25, 0.25 - PI), (-7.0, TAU - 7.0)] {
            assert!((wrap_angle(angle) - expected).abs() < 1e-12, "{angle}");
        }
        let body = pose(1.0, 1.0, 0.8, Vector3::z() * FRAC_PI_2);
        assert!((facing_angle(&body, &Vector3::new(0.0, 2.0, 5.0)) - FRAC_PI_4).abs() < 1e-12);
        assert!((facing_angle(&body, &Vector3::new(2.0, 1.0, 0.0)) + FRAC_PI_2).abs() < 1e-12);
    }

    #[test]
    fn footprint() {
        let body = pose(2.0, 0.0, 0.0, Vector3::z() * FRAC_PI_2);
        for (point, expected) in [((2.1, 0.2), 0.0), ((2.5, 0.0), 0.3), ((2.5, 0.7), 0.5)] {
            let distance = footprint_distance(&body, &[0.3, 0.2], &Vector3::new(point.0, point.1, 1.0));
            assert!((distance - expected).abs() < 1e-12, "{point:?}: {distance}");
        }
        assert!(footprint_distance(&body, &[0.3, 0.2], &Vector3::new(f64::NAN, 0.0, 0.0)).is_nan());
    }

    /// A cone frustum's extent against points sampled on its surface.
    #[test]
    fn revolved_extent_agrees_with_samples() {
        let outline = [[0.1, 0.3], [0.5, 0.2], [0.6, 0.0]];
        let body = pose(0.3, -0.4, 1.0, Vector3::new(0.8, -0.5, 0.3));
        let mut sampled = [Extent { min: f64::INFINITY, max: f64::NEG_INFINITY }; 3];
        for [z, r] in outline {
            for k in 0..3600 {
                let angle = f64::from(k) * TAU / 3600.0;
                let point = world_point(&body, &Vector3::new(r * libm::cos(angle), r * libm::sin(angle), z));
                for axis in 0..3 {
                    sampled[axis].min = sampled[axis].min.min(point[axis]);
                    sampled[axis].max = sampled[axis].max.max(point[axis]);
                }
            }
        }
        let extents = extents_in(&outline, &body, &Isometry3::identity());
        for axis in 0..3 {
            let error =
                (extents[axis].min - sampled[axis].min).abs().max((extents[axis].max - sampled[axis].max).abs());
            assert!(error < 1e-5, "{axis}: {error}");
        }
        assert_eq!(lowest_point(&outline, &body), extents[2].min);
    }

    #[test]
    fn standing_and_lying_cylinder() {
        let outline = [[0.0, 0.02], [0.1, 0.02]];
        assert!((lowest_point(&outline, &pose(0.0, 0.0, 0.5, Vector3::zeros())) - 0.5).abs() < 1e-15);
        let lying = pose(0.0, 0.0, 0.5, Vector3::x() * FRAC_PI_2);
        assert!((lowest_point(&outline, &lying) - 0.48).abs() < 1e-15);
    }
}
