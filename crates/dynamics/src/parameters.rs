//! The numbers of a model that may differ between worlds that share it, and what is derived from them.

use std::sync::atomic::{AtomicU64, Ordering};

use nalgebra::{Matrix3, Vector3};

use crate::spec::{BodyId, BodySpec, Drive, Material};

/// One set of these numbers: a model holds its nominal one, a varied world holds its own.
#[derive(Debug, Clone)]
pub(crate) struct Parameters {
    pub bodies: Vec<Inertial>,
    /// Bodies with drives, in the order of `targets`.
    pub drives: Vec<(BodyId, Drive)>,
    /// Surface of each shape.
    pub materials: Vec<Material>,
    pub inverse_weights: InverseWeights,
    /// World, m/s^2.
    pub gravity: Vector3<f64>,
    /// Tells these numbers from all others of this process, for what is remembered of them.
    pub id: u64,
}

/// A number that no other parameters have.
pub(crate) fn new_id() -> u64 {
    static NEXT: AtomicU64 = AtomicU64::new(0);
    NEXT.fetch_add(1, Ordering::Relaxed)
}

/// Mass properties of one body.
#[derive(Debug, Clone)]
pub(crate) struct Inertial {
    pub mass: f64,
    /// Centre of mass in the body's frame.
    pub com: Vector3<f64>,
    /// About the centre of mass, body axes.
    pub inertia: Matrix3<f64>,
}

/// Inverse inertias in the reference pose, by which contacts and joint limits are regularised.
#[derive(Debug, Clone, Default)]
pub(crate) struct InverseWeights {
    /// Mean over directions of the inverse inertia at each body's centre of mass, 1/kg. Drives count with what they add to
    /// the inertia in an implicit step of nominal length.
    pub bodies: Vec<f64>,
    /// Diagonal of the inverse of the same matrix.
    pub dofs: Vec<f64>,
}

impl Inertial {
    pub fn of(spec: &BodySpec) -> Self {
        Self { mass: spec.mass, com: spec.com, inertia: spec.inertia }
    }
}
