//! Geometries of collision shapes. What depends on the kind of geometry is a method here; contacts are in `collide`.

mod ray;

use std::f64::consts::PI;
use std::sync::Arc;

use nalgebra::{Matrix3, Vector3};

use crate::hull::Hull;
use crate::solid::Solid;

/// A collision shape's geometry, about its own frame.
#[derive(Debug, Clone, PartialEq)]
pub enum Geometry {
    /// All points with z below 0; only on the world.
    HalfSpace,
    /// A ball about the origin of the shape's frame.
    Sphere {
        /// Radius of the ball, m.
        radius: f64,
    },
    /// A segment of length `2 half_length` along z, thickened by `radius`.
    Capsule {
        /// Radius of the caps and of the cylinder between them, m.
        radius: f64,
        /// Half the length of the segment between the two cap centres, m.
        half_length: f64,
    },
    /// A box that is centred on the origin of the shape's frame.
    Cuboid {
        /// Half the length of each edge along x, y and z, m.
        half_extents: Vector3<f64>,
    },
    /// A convex polyhedron anywhere in the shape's frame; shapes may share one.
    Hull(Arc<Hull>),
}

impl Geometry {
    /// Half the lengths of a box's edges, m; none for another kind.
    pub fn as_cuboid(&self) -> Option<Vector3<f64>> {
        if let Self::Cuboid { half_extents } = self { Some(*half_extents) } else { None }
    }

    /// Radius and half the length of a capsule, m; none for another kind.
    pub fn as_capsule(&self) -> Option<(f64, f64)> {
        if let Self::Capsule { radius, half_length } = self { Some((*radius, *half_length)) } else { None }
    }

    /// Reach from its origin along a unit vector, m. Infinite for a half-space.
    pub fn reach(&self, direction: &Vector3<f64>) -> f64 {
        match self {
            Self::HalfSpace => f64::INFINITY,
            Self::Sphere { radius } => *radius,
            Self::Capsule { radius, half_length } => radius + half_length * direction.z.abs(),
            Self::Cuboid { half_extents } => half_extents.dot(&direction.abs()),
            Self::Hull(hull) => hull.support(direction).dot(direction),
        }
    }

    /// The point that is farthest along a vector, m. The origin for a half-space, which has none.
    pub fn support(&self, direction: &Vector3<f64>) -> Vector3<f64> {
        match self {
            Self::HalfSpace => Vector3::zeros(),
            Self::Sphere { radius } => *radius * direction.normalize(),
            Self::Capsule { radius, half_length } => {
                *radius * direction.normalize() + Vector3::z() * half_length.copysign(direction.z)
            }
            Self::Cuboid { half_extents } => half_extents.zip_map(direction, f64::copysign),
            Self::Hull(hull) => *hull.support(direction),
        }
    }

    /// Lowest and highest coordinates in a frame of the same origin, m; none for a half-space.
    #[inline(always)]
    pub fn bounds(&self, frame_from_shape: &Matrix3<f64>) -> Option<[Vector3<f64>; 2]> {
        let half = match self {
            Self::HalfSpace => return None,
            Self::Sphere { radius } => Vector3::repeat(*radius),
            Self::Capsule { radius, half_length } => {
                (frame_from_shape.column(2) * *half_length).abs().add_scalar(*radius)
            }
            Self::Cuboid { half_extents } => frame_from_shape.abs() * half_extents,
            Self::Hull(hull) => return Some(hull.bounds(frame_from_shape)),
        };
        Some([-half, half])
    }

    /// Distance of its farthest point from its origin, m; 0 for a half-space.
    pub fn radius(&self) -> f64 {
        match self {
            Self::HalfSpace => 0.0,
            Self::Sphere { radius } => *radius,
            Self::Capsule { radius, half_length } => radius + half_length,
            Self::Cuboid { half_extents } => half_extents.norm(),
            Self::Hull(hull) => hull.radius(),
        }
    }

    /// Mass properties at density 1; all zero for a half-space.
    pub fn solid(&self) -> Solid {
        let (volume, moments) = match self {
            Self::HalfSpace => (0.0, Vector3::zeros()),
            Self::Sphere { radius: r } => {
                let ball = 4.0 / 3.0 * PI * r * r * r;
                (ball, Vector3::from_element(ball * 0.4 * r * r))
            }
            Self::Capsule { radius: r, half_length } => {
                let length = 2.0 * half_length;
                let (tube, ball) = (PI * r * r * length, 4.0 / 3.0 * PI * r * r * r);
                let along = tube * r * r / 2.0 + ball * 0.4 * r * r;
                let across = tube * (length * length / 12.0 + r * r / 4.0)
                    + ball * (0.4 * r * r + length * length / 4.0 + 0.375 * length * r);
                (tube + ball, Vector3::new(across, across, along))
            }
            Self::Cuboid { half_extents: h } => {
                let volume = 8.0 * h.x * h.y * h.z;
                let square = h.component_mul(h);
                let moments = Vector3::new(square.y + square.z, square.x + square.z, square.x + square.y);
                (volume, moments * (volume / 3.0))
            }
            Self::Hull(hull) => return hull.solid(),
        };
        Solid { volume, center: Vector3::zeros(), inertia: Matrix3::from_diagonal(&moments) }
    }

    /// Distance along a ray to its first point, m; 0 from inside. `direction` is a unit vector.
    pub fn cast_ray(&self, origin: &Vector3<f64>, direction: &Vector3<f64>) -> Option<f64> {
        match self {
            Self::HalfSpace if origin.z <= 0.0 => Some(0.0),
            Self::HalfSpace => (direction.z < 0.0).then(|| -origin.z / direction.z),
            Self::Sphere { radius } => ray::capsule(origin, direction, *radius, 0.0),
            Self::Capsule { radius, half_length } => ray::capsule(origin, direction, *radius, *half_length),
            Self::Cuboid { half_extents } => ray::cuboid(origin, direction, half_extents),
            Self::Hull(hull) => hull.cast_ray(origin, direction),
        }
    }

    /// The lengths that must be positive, m, and their names.
    pub(crate) fn sizes(&self) -> impl Iterator<Item = (&'static str, f64)> {
        let sizes = match *self {
            Self::HalfSpace | Self::Hull(_) => [None; 3],
            Self::Sphere { radius } => [Some(("radius", radius)), None, None],
            Self::Capsule { radius, half_length } => {
                [Some(("radius", radius)), Some(("half_length", half_length)), None]
            }
            Self::Cuboid { half_extents: h } => [h.x, h.y, h.z].map(|half| Some(("half_extents", half))),
        };
        sizes.into_iter().flatten()
    }
}
