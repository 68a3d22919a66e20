//! Shapes placed before a sensor.

use fiatlux_dynamics::Geometry;
use nalgebra::{Isometry3, Matrix3, Vector3};

/// A shape of a prop, in the prop's frame.
#[derive(Debug, Clone)]
pub(super) struct Target {
    prop_from_shape: Isometry3<f64>,
    geometry: Geometry,
    /// Half extents of a box about its origin that bounds it, in its own frame, m.
    half: Vector3<f64>,
}

impl Target {
    /// `None` for what has no bounds.
    pub fn new(geometry: &Geometry, prop_from_shape: Isometry3<f64>) -> Option<Self> {
        let [low, high] = geometry.bounds(&Matrix3::identity())?;
        Some(Self { prop_from_shape, geometry: geometry.clone(), half: high.sup(&-low) })
    }

    /// In the frame of a sensor.
    pub fn place(&self, sensor_from_prop: &Isometry3<f64>) -> Placed<'_> {
        let sensor_from_shape = sensor_from_prop * self.prop_from_shape;
        let center = sensor_from_shape.translation.vector;
        let axes = sensor_from_shape.rotation.to_rotation_matrix().into_inner();
        Placed { geometry: &self.geometry, half: self.half, center, axes, eye: -axes.tr_mul(&center) }
    }
}

/// A shape in the frame of a sensor, whose rays start at the origin.
#[derive(Debug)]
pub(super) struct Placed<'a> {
    geometry: &'a Geometry,
    half: Vector3<f64>,
    pub center: Vector3<f64>,
    /// The shape's axes as columns.
    axes: Matrix3<f64>,
    /// The sensor in the shape's frame.
    eye: Vector3<f64>,
}

impl Placed<'_> {
    /// A distance that the shape surely keeps from the sensor, m.
    pub fn gap(&self) -> f64 {
        self.center.norm() - self.half.norm()
    }

    /// Corners of the bounding box.
    pub fn corners(&self) -> [Vector3<f64>; 8] {
        std::array::from_fn(|corner| {
            let sign = |axis: usize| if corner >> axis & 1 == 0 { -1.0 } else { 1.0 };
            let local = Vector3::new(sign(0) * self.half.x, sign(1) * self.half.y, sign(2) * self.half.z);
            self.center + self.axes * local
        })
    }

    /// Lowers ranges, m, along unit vectors (their x, y and z) to what the shape is hit at.
    pub fn cast_all(&self, [x, y, z]: [&[f64]; 3], ranges: &mut [f32]) {
        let axis = self.axis();
        let mut from = 0;
        while from < ranges.len() {
            let to = ranges.len().min(from + LANES);
            let misses = axis.as_ref().is_some_and(|axis| to == from + LANES && axis.misses(x, y, z, from));
            for ray in if misses { to..to } else { from..to } {
                if let Some(range) = self.cast(&Vector3::new(x[ray], y[ray], z[ray])) {
                    ranges[ray] = ranges[ray].min(range as f32);
                }
            }
            from = to;
        }
    }

    /// The line that a capsule lies on.
    fn axis(&self) -> Option<Axis> {
        let Geometry::Capsule { radius, .. } = self.geometry else { return None };
        let [across, other] = [0, 1].map(|axis| self.axes.column(axis).into_owned());
        let outside = self.eye.x * self.eye.x + self.eye.y * self.eye.y - radius * radius;
        Some(Axis { across: [across, other], eye: [self.eye.x, self.eye.y], outside })
    }

    /// Distance along a unit vector, m; 0 from inside.
    pub fn cast(&self, direction: &Vector3<f64>) -> Option<f64> {
        self.geometry.cast_ray(&self.eye, &self.axes.tr_mul(direction))
    }
}

/// Rays that are looked at together.
const LANES: usize = 4;

/// An endless round bar, in which a capsule lies: a ray that misses it misses the capsule.
struct Axis {
    /// Two directions across it, in the frame of the sensor.
    across: [Vector3<f64>; 2],
    /// Where the sensor is along these, m.
    eye: [f64; 2],
    /// Square of the sensor's distance less that of the radius, m^2.
    outside: f64,
}

impl Axis {
    /// True if all rays of a group pass it by, by far more than rounding.
    #[inline(always)]
    fn misses(&self, x: &[f64], y: &[f64], z: &[f64], from: usize) -> bool {
        /// Of the difference of two squares of distances, m^2.
        const SLACK: f64 = 1e-9;
        let (x, y, z) = (&x[from..from + LANES], &y[from..from + LANES], &z[from..from + LANES]);
        let [u, v] = &self.across;
        let mut beside = [0.0; LANES];
        for k in 0..LANES {
            let along = [u.x * x[k] + u.y * y[k] + u.z * z[k], v.x * x[k] + v.y * y[k] + v.z * z[k]];
            let square = along[0] * along[0] + along[1] * along[1];
            let toward = self.eye[0] * along[0] + self.eye[1] * along[1];
            beside[k] = toward * toward - square * (self.outside - SLACK);
        }
        beside.iter().all(|beside| *beside < 0.0)
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use std::sync::Arc;

    use fiatlux_dynamics::Hull;

    use super::*;

    /// A hull off its shape's origin is seen where the same box is, and lies within its bounding box.
    #[test]
    fn a_hull_of_a_box_is_seen_as_the_box() {
        let (half_extents, center) = (Vector3::new(0.3, 0.2, 0.1), Vector3::new(0.5, -0.1, 0.2));
        let sign = |k: usize, axis: usize| if k >> axis & 1 == 0 { -1.0 } else { 1.0 };
        let corner = |k| center + half_extents.component_mul(&Vector3::new(sign(k, 0), sign(k, 1), sign(k, 2)));
        let corners: Vec<_> = (0..8).map(corner).collect();
        let hull = Geometry::Hull(Arc::new(Hull::new("box", &corners).unwrap()));
        let pose = Isometry3::new(Vector3::new(2.0, 0.5, 0.1), Vector3::new(0.3, -0.2, 0.7));
        let hull = Target::new(&hull, Isometry3::identity()).unwrap();
        let boxed = Target::new(&Geometry::Cuboid { half_extents }, Isometry3::from(center)).unwrap();
        let (hull, boxed) = (hull.place(&pose), boxed.place(&pose));
        assert!(hull.gap() <= boxed.cast(&boxed.center.normalize()).unwrap());
        let mut hits = 0;
        for k in 0..400 {
            let along =
                boxed.center.normalize() + Vector3::new(0.0, f64::from(k % 20) - 9.5, f64::from(k / 20) - 9.5) * 0.02;
            let (found, expected) = (hull.cast(&along.normalize()), boxed.cast(&along.normalize()));
            assert_eq!(found.is_some(), expected.is_some());
            hits += usize::from(found.is_some());
            assert!((found.unwrap_or(0.0) - expected.unwrap_or(0.0)).abs() < 1e-9, "{found:?} {expected:?}");
        }
        assert!((50..350).contains(&hits), "{hits}");
    }
}
