//! A pixel that is lit, and the sizes of what floor and walls show there.

use crate::single::Vec3;

/// Side of a floor tile and width of a joint between tiles, m.
pub(crate) const TILE: f32 = 0.5;
pub(crate) const GROUT: f32 = 0.006;
/// Height of the skirting on the walls, m.
pub(crate) const SKIRTING: f32 = 0.09;

/// Cosine of the flattest look at the floor that widens a pixel.
pub(crate) const MIN_SLANT: f32 = 0.05;

/// Geometry and light of a pixel.
pub(crate) struct Spot {
    pub point: Vec3,
    /// Unit normal of the surface.
    pub normal: Vec3,
    /// From the eye; of any length above 0.
    pub ray: Vec3,
    /// Width of the pixel on a surface that faces it, m.
    pub footprint: f32,
    /// Share of the dome that is not occluded.
    pub open: f32,
    /// Share of the key light that arrives.
    pub lit: f32,
}
