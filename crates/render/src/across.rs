//! The frame across the key light.

use crate::raster::Corner;
use crate::single::{Vec3, dot};

/// The frame of the map: two axes across the light and one towards it.
#[derive(Debug, Clone)]
pub(crate) struct Across {
    pub axes: [Vec3; 3],
    /// Texels a metre, and the map's lower corner across the light.
    pub texels: f32,
    pub corner: [f32; 2],
}

impl Across {
    #[inline(always)]
    pub(crate) fn texel(&self, point: Vec3) -> [f32; 2] {
        let along = |i: usize| (dot(self.axes[i], point) - self.corner[i]) * self.texels - 0.5;
        [along(0), along(1)]
    }

    /// Where a point of the world is on the map.
    #[inline(always)]
    pub(crate) fn corner_of(&self, point: Vec3) -> Corner {
        let [u, v] = self.texel(point);
        Corner { u, v, depth: dot(self.axes[2], point) }
    }
}
