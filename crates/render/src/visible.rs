//! Visible triangles: which pixels they are the nearest at, and what lights them.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x8, mask32x8, u32x8};

use crate::paint::Paint;
use crate::raster::{Canvas, Plane, Setup};
use crate::single::{Vec3, normalize, scale};

/// A visible triangle: what is needed to light its pixels.
#[derive(Debug, Clone)]
pub(crate) struct Surface {
    /// Components of the normal times the inverse depth, which are linear over the picture.
    pub normal: [Plane; 3],
    /// The unit normal, where it is the same all over.
    pub flat: Option<Vec3>,
    pub paint: Paint,
    pub mesh: u16,
}

impl Surface {
    #[inline]
    pub(crate) fn normal_at(&self, x: usize, y: usize) -> Vec3 {
        if let Some(normal) = self.flat {
            return normal;
        }
        let (u, v) = (x as f32, y as f32);
        normalize([self.normal[0].at(u, v), self.normal[1].at(u, v), self.normal[2].at(u, v)])
    }
}

/// Draws triangles of a mesh into a picture: depth, number of the nearest, and what lights it.
pub(crate) struct Painter<'a, N, P> {
    pub size: [usize; 2],
    pub depth: &'a mut [f32],
    pub ids: &'a mut [u32],
    pub surfaces: &'a mut Vec<Surface>,
    pub mesh: u16,
    /// Unit normals at the corners of a triangle, by its place in the list, and its paint.
    pub normals: N,
    pub paint: P,
}

impl<N: Fn(u32) -> [Vec3; 3], P: Fn(u32) -> Paint> Canvas for Painter<'_, N, P> {
    #[inline(always)]
    fn size(&self) -> [usize; 2] {
        self.size
    }

    #[inline(always)]
    fn put<S: Simd>(&mut self, simd: S, at: usize, value: f32x8<S>, inside: mask32x8<S>) -> bool {
        let here = &mut self.depth[at..at + 8];
        let before = f32x8::from_slice(simd, here);
        let nearer = value.simd_gt(before) & inside;
        nearer.select(value, before).store_slice(here);
        let here = &mut self.ids[at..at + 8];
        let id = u32x8::splat(simd, self.surfaces.len() as u32);
        nearer.select(id, u32x8::from_slice(simd, here)).store_slice(here);
        nearer.any_true()
    }

    #[inline(always)]
    fn seen<S: Simd>(&mut self, simd: S, place: u32, setup: &Setup, depths: [f32; 3]) {
        let [a, b, c] = (self.normals)(place);
        let flat = (a == b && b == c).then_some(a);
        let normal = match flat {
            Some(_) => [Plane::default(); 3],
            None => setup.planes(simd, [scale(a, depths[0]), scale(b, depths[1]), scale(c, depths[2])]),
        };
        self.surfaces.push(Surface { normal, flat, paint: (self.paint)(place), mesh: self.mesh });
    }
}
