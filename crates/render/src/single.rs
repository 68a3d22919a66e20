//! Vectors and poses in single precision.

use nalgebra::{Isometry3, Vector3};

pub(crate) type Vec3 = [f32; 3];

#[inline(always)]
pub(crate) fn dot(a: Vec3, b: Vec3) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[inline(always)]
pub(crate) fn cross(a: Vec3, b: Vec3) -> Vec3 {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

#[inline(always)]
pub(crate) fn add(a: Vec3, b: Vec3) -> Vec3 {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

#[inline(always)]
pub(crate) fn sub(a: Vec3, b: Vec3) -> Vec3 {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

#[inline(always)]
pub(crate) fn scale(a: Vec3, by: f32) -> Vec3 {
    [a[0] * by, a[1] * by, a[2] * by]
}

#[inline]
pub(crate) fn product(a: Vec3, b: Vec3) -> Vec3 {
    [a[0] * b[0], a[1] * b[1], a[2] * b[2]]
}

#[inline]
pub(crate) fn mix(a: Vec3, b: Vec3, share: f32) -> Vec3 {
    add(a, scale(sub(b, a), share))
}

#[inline]
pub(crate) fn normalize(a: Vec3) -> Vec3 {
    scale(a, 1.0 / dot(a, a).max(1e-30).sqrt())
}

/// The next whole number below; for values within +-2^22.
#[inline]
pub(crate) fn floor(x: f32) -> f32 {
    // Adding this rounds to a whole number, at a fraction of the cost of a checked cast.
    const WHOLE: f32 = 1.5 * (1 << 23) as f32;
    let near = (x + WHOLE) - WHOLE;
    if near > x { near - 1.0 } else { near }
}

pub(crate) fn single(v: &Vector3<f64>) -> Vec3 {
    [v.x as f32, v.y as f32, v.z as f32]
}

pub(crate) struct SinglePose {
    rows: [Vec3; 3],
    shift: Vec3,
}

impl SinglePose {
    pub(crate) fn new(pose: &Isometry3<f64>) -> Self {
        let matrix = pose.rotation.to_rotation_matrix();
        let rows = [0, 1, 2].map(|i| [0, 1, 2].map(|j| matrix[(i, j)] as f32));
        Self { rows, shift: single(&pose.translation.vector) }
    }

    #[inline(always)]
    pub(crate) fn point(&self, p: Vec3) -> Vec3 {
        add(self.vector(p), self.shift)
    }

    #[inline(always)]
    pub(crate) fn vector(&self, v: Vec3) -> Vec3 {
        [dot(self.rows[0], v), dot(self.rows[1], v), dot(self.rows[2], v)]
    }
}
