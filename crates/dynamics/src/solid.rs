use nalgebra::{Matrix3, Vector3};

/// Mass properties of a body of density 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Solid {
    /// Volume, m^3.
    pub volume: f64,
    /// Centre of mass, m.
    pub center: Vector3<f64>,
    /// Inertia about the centre of mass, m^5.
    pub inertia: Matrix3<f64>,
}
