//! The key light's shadow map, fitted to what the picture shows.

use fearless_simd::prelude::*;
use fearless_simd::{Level, Simd, dispatch, f32x8, mask32x8};

use crate::across::Across;
use crate::mesh::Triangle;
use crate::raster::{self, Canvas, Four, LANES, SPARE, Setup};
use crate::single::{Vec3, add, cross, dot, normalize, scale};
use crate::transform::Projected;
use crate::wide::vector as wide;

/// Share of the map's side that is kept free around what is visible.
const MARGIN: f32 = 0.03;
/// A surface is lit while it is no deeper than this in a shadow, m.
const BIAS: f32 = 0.003;
/// Side of a block of texels; the map's side is a multiple of it.
const BLOCK: usize = 8;
/// Half the angle that the key light fills in the soft filter, as a slope; ours.
const SUN_SLOPE: f32 = 0.035;

/// Height along the light of the uppermost thing that turns its back to the light, over a grid across the light. Backs
/// instead of fronts: a lit surface never shades itself.
#[derive(Debug, Clone)]
pub(crate) struct ShadowMap {
    size: usize,
    height: Vec<f32>,
    /// The largest height in each block of texels and those around it that the filter takes in.
    blocks: Vec<f32>,
    /// The largest height in each column of a row of blocks, from the one before the first on.
    columns: Vec<f32>,
    across: Across,
    /// Triangles to be drawn.
    four: Four,
    /// Range of what is visible across the light.
    low: [f32; 2],
    high: [f32; 2],
}

impl ShadowMap {
    pub(crate) fn new(size: usize) -> Self {
        let zero = [0.0; 3];
        Self {
            size,
            height: vec![0.0; size * size + SPARE],
            blocks: vec![0.0; (size / BLOCK) * (size / BLOCK)],
            columns: vec![0.0; size + BLOCK],
            four: Four::default(),
            across: Across { axes: [zero; 3], texels: 1.0, corner: [0.0; 2] },
            low: [0.0; 2],
            high: [0.0; 2],
        }
    }

    /// Starts a frame; `towards` is the unit vector to the light.
    pub(crate) fn aim(&mut self, towards: Vec3) {
        let helper = if towards[0].abs() < 0.7 { [1.0, 0.0, 0.0] } else { [0.0, 1.0, 0.0] };
        let across = normalize(cross(helper, towards));
        // The map is a mirror image of what the light sees, so that the rasteriser keeps the backs.
        self.across.axes = [across, cross(towards, across), towards];
        self.low = [f32::INFINITY; 2];
        self.high = [f32::NEG_INFINITY; 2];
    }

    /// Notes a visible point that may lie in shadow.
    pub(crate) fn see(&mut self, point: Vec3) {
        for i in 0..2 {
            let at = dot(self.across.axes[i], point);
            self.low[i] = self.low[i].min(at);
            self.high[i] = self.high[i].max(at);
        }
    }

    /// Fits the map to the visible points and clears it; false where there is none.
    pub(crate) fn fit(&mut self) -> bool {
        let side = (self.high[0] - self.low[0]).max(self.high[1] - self.low[1]);
        if !side.is_finite() {
            return false;
        }
        let side = (side * (1.0 + 2.0 * MARGIN)).max(0.2);
        self.across.texels = self.size as f32 / side;
        for i in 0..2 {
            let corner = (self.low[i] + self.high[i]) / 2.0 - side / 2.0;
            // Whole texels: shadows do not crawl while the camera moves on a little.
            self.across.corner[i] = libm::floorf(corner * self.across.texels) / self.across.texels;
        }
        self.height.fill(f32::NEG_INFINITY);
        true
    }

    /// True if a sphere can throw a shadow on anything visible.
    pub(crate) fn reaches(&self, center: Vec3, radius: f32) -> bool {
        (0..2).all(|i| {
            let at = dot(self.across.axes[i], center);
            at + radius >= self.low[i] && at - radius <= self.high[i]
        })
    }

    /// Texels of a side.
    pub(crate) fn size(&self) -> usize {
        self.size
    }

    pub(crate) fn across(&self) -> &Across {
        &self.across
    }

    /// Draws triangles whose corners, on the map, are counter-clockwise seen from outside.
    pub(crate) fn draw(&mut self, level: Level, triangles: &[Triangle], corners: &Projected) {
        dispatch!(level, simd => self.draw_wide(simd, triangles, corners));
    }

    #[inline(always)]
    fn draw_wide<S: Simd>(&mut self, simd: S, triangles: &[Triangle], corners: &Projected) {
        let columns = corners.columns();
        let mut four = std::mem::take(&mut self.four);
        let mut left = triangles.iter();
        loop {
            let full = left.any(|triangle| {
                let vertices = triangle.indices();
                corners.may_cover(vertices) && four.push(columns, vertices, 0)
            });
            raster::draw(simd, &mut four, self);
            if !full {
                break;
            }
        }
        self.four = four;
    }

    /// Ends the drawing: finds the greatest height of each block.
    pub(crate) fn finish(&mut self, level: Level) {
        dispatch!(level, simd => self.finish_wide(simd));
    }

    #[inline(always)]
    fn finish_wide<S: Simd>(&mut self, simd: S) {
        let (size, count) = (self.size, self.size / BLOCK);
        for j in 0..count {
            let rows = (j * BLOCK).saturating_sub(1)..(j * BLOCK + BLOCK + 2).min(size);
            // First down each column, then across: a tenth of the comparisons. A column more before the first and some after the
            // last, where nothing is.
            self.columns.fill(f32::NEG_INFINITY);
            for row in self.height[rows.start * size..rows.end * size].chunks_exact(size) {
                let columns = self.columns[1..].chunks_exact_mut(LANES);
                for (most, heights) in columns.zip(row.chunks_exact(LANES)) {
                    let heights = f32x8::from_slice(simd, heights);
                    wide::greater(heights, f32x8::from_slice(simd, most)).store_slice(most);
                }
            }
            for (i, most) in self.blocks[j * count..(j + 1) * count].iter_mut().enumerate() {
                // From the column before the block to the second after it.
                let columns = &self.columns[i * BLOCK..i * BLOCK + BLOCK + 3];
                let (left, right) =
                    (f32x8::from_slice(simd, &columns[..LANES]), f32x8::from_slice(simd, &columns[3..3 + LANES]));
                *most = wide::greater(left, right).reduce_max();
            }
        }
    }

    /// Share of the key light that reaches a point with that normal: a tent of three by three texels.
    pub(crate) fn light(&self, point: Vec3, normal: Vec3) -> f32 {
        // A step off the surface of about a texel keeps slanted ones clear of their own edges.
        let point = add(point, scale(normal, 1.2 / self.across.texels));
        let height = dot(self.across.axes[2], point) + BIAS;
        let [u, v] = self.across.texel(point);
        self.light_at(height, u, v)
    }

    /// Share of the key light that reaches a height at a place of the map, texels.
    #[inline(always)]
    fn light_at(&self, height: f32, u: f32, v: f32) -> f32 {
        let last = self.size as f32 - 3.0;
        if !(u >= 1.0 && v >= 1.0 && u < last && v < last) {
            return 1.0;
        }
        let (x, y) = (u as u32 as usize, v as u32 as usize);
        let (fu, fv) = (u - x as f32, v - y as f32);
        if height >= self.blocks[(y / BLOCK) * (self.size / BLOCK) + x / BLOCK] {
            return 1.0;
        }
        let across = [1.0 - fu, 1.0, 1.0, fu];
        let down = [1.0 - fv, 1.0, 1.0, fv];
        let mut sum = 0.0;
        let mut any = false;
        for (j, weight) in down.iter().enumerate() {
            let from = (y + j - 1) * self.size + x - 1;
            let row = &self.height[from..from + 4];
            let mut lit = 0.0;
            for i in 0..4 {
                lit += if row[i] <= height { across[i] } else { 0.0 };
                any |= row[i] > height;
            }
            sum += weight * lit;
        }
        // Exactly 1 where nothing is in the way.
        if any { sum / 9.0 } else { 1.0 }
    }

    /// [`ShadowMap::light`] at eight points; 1 where a bit of `asked` is not set.
    #[inline(always)]
    pub(crate) fn light_eight<S: Simd>(
        &self,
        simd: S,
        point: [f32x8<S>; 3],
        normal: [f32x8<S>; 3],
        asked: u64,
    ) -> [f32; LANES] {
        let across = &self.across;
        let point = wide::add(point, wide::scale(normal, f32x8::splat(simd, 1.2 / across.texels)));
        let height = wide::dot(wide::wide3(simd, across.axes[2]), point) + f32x8::splat(simd, BIAS);
        let (texels, half) = (f32x8::splat(simd, across.texels), f32x8::splat(simd, 0.5));
        let (along, down) = (wide::wide3(simd, across.axes[0]), wide::wide3(simd, across.axes[1]));
        let u = (wide::dot(along, point) - f32x8::splat(simd, across.corner[0])) * texels - half;
        let v = (wide::dot(down, point) - f32x8::splat(simd, across.corner[1])) * texels - half;
        let [height, u, v]: [[f32; LANES]; 3] = [height.into(), u.into(), v.into()];
        let mut light = [1.0; LANES];
        for k in 0..LANES {
            if asked >> k & 1 == 1 {
                light[k] = self.light_at(height[k], u[k], v[k]);
            }
        }
        light
    }

    /// As [`ShadowMap::light`] with a shadow that is the softer the farther it falls. `turn` in [0, 1) turns the pattern of
    /// samples.
    pub(crate) fn soft_light(&self, point: Vec3, normal: Vec3, turn: f32) -> f32 {
        let point = add(point, scale(normal, 1.5 / self.across.texels));
        let height = dot(self.across.axes[2], point) + BIAS;
        let [u, v] = self.across.texel(point);
        let at = |radius: f32, k: usize| -> f32 {
            let [du, dv] = disc_sample(k, turn);
            let (x, y) = (u + radius * du + 0.5, v + radius * dv + 0.5);
            let last = self.size as f32;
            if x >= 0.0 && y >= 0.0 && x < last && y < last {
                self.height[y as usize * self.size + x as usize]
            } else {
                f32::NEG_INFINITY
            }
        };
        let search = (0.05 * self.across.texels).max(2.0);
        let (mut blockers, mut above) = (0.0, 0.0);
        for k in 0..SAMPLES {
            let top = at(search, k);
            if top > height {
                blockers += 1.0;
                above += top - height;
            }
        }
        if blockers == 0.0 {
            return 1.0;
        }
        let radius = (above / blockers * SUN_SLOPE * self.across.texels).clamp(1.2, search);
        let lit = (0..SAMPLES).filter(|&k| at(radius, k) <= height).count();
        lit as f32 / SAMPLES as f32
    }
}

impl Canvas for ShadowMap {
    #[inline(always)]
    fn size(&self) -> [usize; 2] {
        [self.size; 2]
    }

    #[inline(always)]
    fn put<S: Simd>(&mut self, simd: S, at: usize, value: f32x8<S>, inside: mask32x8<S>) -> bool {
        let here = &mut self.height[at..at + 8];
        let before = f32x8::from_slice(simd, here);
        (value.simd_gt(before) & inside).select(value, before).store_slice(here);
        false
    }

    #[inline(always)]
    fn seen<S: Simd>(&mut self, _: S, _: u32, _: &Setup, _: [f32; 3]) {}
}

const SAMPLES: usize = 16;

/// Points of a disc of radius 1, even in area (a sunflower's seeds), turned.
fn disc_sample(k: usize, turn: f32) -> [f32; 2] {
    let radius = libm::sqrtf((k as f32 + 0.5) / SAMPLES as f32);
    let angle = 2.399_963_2 * k as f32 + std::f32::consts::TAU * turn;
    [radius * libm::cosf(angle), radius * libm::sinf(angle)]
}
