//! Ambient occlusion: how much of the dome a pixel sees past its neighbours.

use std::f32::consts::FRAC_1_SQRT_2;

use fearless_simd::prelude::*;
use fearless_simd::{Level, Simd, dispatch, f32x8, i32x8, u32x8};

use crate::raster::{LANES, Places};
use crate::single::Vec3;
use crate::wide::vector::{self as wide, floor, greater, lesser};

/// Reach of the occlusion, m.
const REACH: f32 = 0.35;
/// Largest reach in the picture, as a share of its height.
const LARGEST: f32 = 0.10;
/// Strength of the darkening, and the least light that is left.
const STRENGTH: f32 = 2.4;
const DARKEST: f32 = 0.15;
/// Neighbours that rise less than this above the surface hide nothing, m.
const FLAT: f32 = 0.004;
/// Neighbours looked at: a sunflower's first six seeds. Each pixel of a block of two by two looks another way.
const SEEDS: [[f32; 2]; 6] =
    [[0.289, 0.000], [-0.369, 0.338], [0.056, -0.643], [0.465, 0.606], [-0.853, -0.151], [0.808, -0.514]];
/// Stands for the background, which hides nothing.
const FAR: (Vec3, f32) = ([1e6; 3], 0.0);
const TURNS: [[f32; 2]; 4] = [[1.0, 0.0], [0.0, 1.0], [FRAC_1_SQRT_2, FRAC_1_SQRT_2], [-FRAC_1_SQRT_2, FRAC_1_SQRT_2]];

/// The light of the dome that is left, at the corners of a grid of square cells of pixels.
#[derive(Debug, Clone)]
pub(crate) struct Occlusion {
    cell: usize,
    width: usize,
    height: usize,
    /// Visible points, each with the inverse of its depth (0 for the background).
    seen: Vec<(Vec3, f32)>,
    /// Light left as found, then as smoothed, and the inverse depth it was found at.
    found: Vec<[f32; 2]>,
    light: Vec<[f32; 2]>,
}

impl Occlusion {
    /// For pictures of that size; `cell` is the side of a cell in pixels.
    pub(crate) fn new(width: usize, height: usize, cell: usize) -> Self {
        let (width, height) = (width.div_ceil(cell) + 1, height.div_ceil(cell) + 1);
        let (pixels, open) = (width * height, [1.0, 0.0]);
        Self { cell, width, height, seen: vec![FAR; pixels], found: vec![open; pixels], light: vec![open; pixels] }
    }

    /// Fills it. For a pixel, `point` is what is visible and the inverse of its depth, and `normal` its unit normal; both
    /// are None for the background; pixels may lie a cell beyond the picture. `focal` is in pixels.
    pub(crate) fn find(
        &mut self,
        level: Level,
        focal: f32,
        point: impl Fn(usize, usize) -> Option<(Vec3, f32)>,
        normal: impl Fn(usize, usize) -> Option<Vec3>,
    ) {
        let (width, height) = (self.width, self.height);
        for (at, seen) in self.seen.iter_mut().enumerate() {
            *seen = point(self.cell * (at % width), self.cell * (at / width)).unwrap_or(FAR);
        }
        for y in 0..height {
            for x in (0..width).step_by(LANES) {
                let count = LANES.min(width - x);
                let mut normals = [None; LANES];
                for (k, of) in normals.iter_mut().enumerate().take(count) {
                    *of = normal(self.cell * (x + k), self.cell * y);
                }
                let index = y * width + x;
                let light = dispatch!(level, simd => self.find_eight(simd, focal, [x, y], &normals));
                for (k, light) in light.into_iter().enumerate().take(count) {
                    self.found[index + k] = [light, self.seen[index + k].1];
                }
            }
        }
        self.smooth();
    }

    /// The light left at eight points of a row; what has no normal keeps all.
    #[inline(always)]
    fn find_eight<S: Simd>(
        &self,
        simd: S,
        focal: f32,
        [x, y]: [usize; 2],
        normals: &[Option<Vec3>; LANES],
    ) -> [f32; LANES] {
        let splat = |value: f32| f32x8::splat(simd, value);
        let (width, height) = (self.width, self.height);
        let (mut at, mut normal, mut turn) = ([[0.0; LANES]; 4], [[0.0; LANES]; 3], [[0.0; LANES]; 2]);
        let (mut column, mut seen) = ([0.0; LANES], [0.0; LANES]);
        for k in 0..LANES {
            let (point, inverse) = self.seen[y * width + (x + k).min(width - 1)];
            (at[0][k], at[1][k], at[2][k], at[3][k]) = (point[0], point[1], point[2], inverse);
            if let Some([a, b, c]) = normals[k] {
                (normal[0][k], normal[1][k], normal[2][k], seen[k]) = (a, b, c, 1.0);
            }
            let [cos, sin] = TURNS[((x + k) % 2) + 2 * (y % 2)];
            (turn[0][k], turn[1][k], column[k]) = (cos, sin, (x + k) as f32);
        }
        let wide = |of: &[f32; LANES]| f32x8::from_slice(simd, of);
        let point = [wide(&at[0]), wide(&at[1]), wide(&at[2])];
        let normal = [wide(&normal[0]), wide(&normal[1]), wide(&normal[2])];
        let (cos, sin, column, row) = (wide(&turn[0]), wide(&turn[1]), wide(&column), splat(y as f32));
        let (zero, one, half) = (splat(0.0), splat(1.0), splat(0.5));
        let reach = splat(REACH * focal) * wide(&at[3]) / splat(self.cell as f32);
        let reach = lesser(reach, splat(LARGEST * height as f32));
        // Adding this leaves a whole number in the lower bits.
        let whole = splat((1 << 23) as f32);
        let [right, bottom, across] = [splat((width - 1) as f32), splat((height - 1) as f32), splat(width as f32)];
        let mut hidden = zero;
        for [u, v] in SEEDS {
            let (u, v) = (splat(u), splat(v));
            // No branch here: half of them would be guessed wrong.
            let qx = column + reach * (u * cos - v * sin) + half;
            let qy = row + reach * (u * sin + v * cos) + half;
            let qx = floor(simd, lesser(greater(qx, zero), right));
            let qy = floor(simd, lesser(greater(qy, zero), bottom));
            let indices: [f32; LANES] = (qy * across + qx + whole).into();
            let mut there = [[0.0; LANES]; 3];
            for (k, index) in indices.into_iter().enumerate() {
                let point = self.seen[(index.to_bits() & 0x7F_FFFF) as usize].0;
                (there[0][k], there[1][k], there[2][k]) = (point[0], point[1], point[2]);
            }
            let way = [wide(&there[0]) - point[0], wide(&there[1]) - point[1], wide(&there[2]) - point[2]];
            let square = wide::dot(way, way);
            let rise = greater(wide::dot(way, normal) - splat(FLAT), zero);
            let fade = greater(one - square * splat(1.0 / (REACH * REACH)), zero);
            hidden += rise * rise * fade / (square + splat(FLAT * FLAT));
        }
        let light = greater(one - splat(STRENGTH / SEEDS.len() as f32) * hidden, splat(DARKEST));
        wide(&seen).simd_gt(zero).select(light, one).into()
    }

    /// Each block of two by two has looked all ways; the mean over them is smooth.
    fn smooth(&mut self) {
        for y in 0..self.height {
            for x in 0..self.width {
                let (left, top) = (x.saturating_sub(1), y.saturating_sub(1));
                let around = [(top, left), (top, x), (y, left), (y, x)].map(|(y, x)| self.found[y * self.width + x]);
                let inverse = around[3][1];
                self.light[y * self.width + x] = [mean_near(&around, [1.0; 4], inverse), inverse];
            }
        }
    }

    /// Light left at a pixel whose inverse depth is given: between those of the corners of its cell at about its depth.
    pub(crate) fn at(&self, x: usize, y: usize, inverse: f32) -> f32 {
        let (left, top) = (x / self.cell, y / self.cell);
        let step = 1.0 / self.cell as f32;
        let (u, v) = ((x % self.cell) as f32 * step, (y % self.cell) as f32 * step);
        let above = top * self.width + left;
        let below = above + self.width;
        let around = [self.light[above], self.light[above + 1], self.light[below], self.light[below + 1]];
        mean_near(&around, [(1.0 - u) * (1.0 - v), u * (1.0 - v), (1.0 - u) * v, u * v], inverse)
    }
}

impl Occlusion {
    /// [`Occlusion::at`] for eight pixels.
    #[inline(always)]
    pub(crate) fn at_eight<S: Simd>(&self, simd: S, at: &Places, inverse: f32x8<S>) -> f32x8<S> {
        let shift = self.cell.trailing_zeros();
        let (mut light, mut depth) = ([[0.0; LANES]; 4], [[0.0; LANES]; 4]);
        for k in 0..LANES {
            let above = (at[1][k] >> shift) as usize * self.width + (at[0][k] >> shift) as usize;
            let (upper, lower) =
                (&self.light[above..above + 2], &self.light[above + self.width..above + self.width + 2]);
            [light[0][k], depth[0][k]] = upper[0];
            [light[1][k], depth[1][k]] = upper[1];
            [light[2][k], depth[2][k]] = lower[0];
            [light[3][k], depth[3][k]] = lower[1];
        }
        let step = f32x8::splat(simd, 1.0 / self.cell as f32);
        let one = f32x8::splat(simd, 1.0);
        let within = |at: &[u32; LANES]| {
            let whole: i32x8<S> = (u32x8::from_slice(simd, at) & u32x8::splat(simd, self.cell as u32 - 1)).bitcast();
            f32x8::float_from(whole) * step
        };
        let (u, v) = (within(&at[0]), within(&at[1]));
        let weights = [(one - u) * (one - v), u * (one - v), (one - u) * v, u * v];
        let tolerance = f32x8::splat(simd, 0.06) * inverse;
        let (mut sum, mut total) = (f32x8::splat(simd, 0.0), f32x8::splat(simd, 0.0));
        for k in 0..4 {
            let (light, depth) = (f32x8::from_slice(simd, &light[k]), f32x8::from_slice(simd, &depth[k]));
            let near = (depth - inverse).abs().simd_lt(tolerance);
            let weight = near.select(weights[k], f32x8::splat(simd, 1e-3) * weights[k]);
            sum += weight * light;
            total += weight;
        }
        sum / total
    }
}

/// Weighted mean of the light of those at about a depth.
#[inline]
fn mean_near(around: &[[f32; 2]; 4], weights: [f32; 4], inverse: f32) -> f32 {
    let tolerance = 0.06 * inverse;
    let (mut sum, mut total) = (0.0, 0.0);
    for ([light, depth], weight) in around.iter().zip(weights) {
        let weight = if (depth - inverse).abs() < tolerance { weight } else { 1e-3 * weight };
        sum += weight * light;
        total += weight;
    }
    sum / total
}
