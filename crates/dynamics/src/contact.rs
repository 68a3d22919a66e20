//! Readings of a contact point after a step.

use nalgebra::Vector3;

use crate::spec::ShapeId;

/// One contact point of the last step (or of a query).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Contact {
    /// The shape that the normal points away from.
    pub shape_a: ShapeId,
    /// The shape that the normal points to.
    pub shape_b: ShapeId,
    /// Point half-way between the surfaces, world, m.
    pub position: Vector3<f64>,
    /// Unit normal from `a` to `b`, world.
    pub normal: Vector3<f64>,
    /// Gap, m; negative when the shapes overlap.
    pub distance: f64,
    /// Coefficient of friction of the pair.
    pub friction: f64,
    /// Levers of the pair's resistance to turning about the normal and to rolling about the tangents, m.
    pub torsion: f64,
    /// See `torsion`.
    pub rolling: f64,
    /// Mean force over the last physics step that `a` exerts on `b`, world, N. Zero in a query.
    pub force: Vector3<f64>,
}
