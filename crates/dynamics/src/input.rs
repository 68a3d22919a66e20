//! Inputs of a step.

use crate::spatial::Wrench;
use crate::spec::BodyId;

/// Influences on the bodies during one step besides gravity, limits and contact.
#[derive(Debug, Clone, Copy, Default)]
pub struct Input<'a> {
    /// Joint targets, rad, in the order of [`Model::drives`](crate::Model::drives).
    pub targets: &'a [f64],
    /// External wrenches on any bodies, constant over the step. Each force acts at its body's centre of mass, in world axes
    /// (see [`Wrench`]); several wrenches on one body add up, and one on [`BodyId::WORLD`] has no effect.
    pub wrenches: &'a [(BodyId, Wrench)],
    /// Degrees of freedom held at rest, `nv` flags; empty: none. With flags, even if none is set, every body is stepped as if it
    /// moved: none is left out because it lies still.
    pub locked: &'a [bool],
}
