//! Ambient occlusion: how much of the dome a pixel sees past its neighbours.

use std::f32::consts::FRAC_1_SQRT_2;

use crate::shade::{Vec3, dot, sub};

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
        focal: f32,
        point: impl Fn(usize, usize) -> Option<(Vec3, f32)>,
        normal: impl Fn(usize, usize) -> Option<Vec3>,
    ) {
        let (width, height) = (self.width, self.height);
        for (at, seen) in self.seen.iter_mut().enumerate() {
            *seen = point(self.cell * (at % width), self.cell * (at / width)).unwrap_or(FAR);
        }
        let largest = LARGEST * height as f32;
        for y in 0..height {
            for x in 0..width {
                let index = y * width + x;
                let (at, inverse) = self.seen[index];
                let mut light = [1.0, inverse];
                if let Some(normal) = normal(self.cell * x, self.cell * y) {
                    let reach = (REACH * focal * inverse / self.cell as f32).min(largest);
                    let turn = TURNS[(x % 2) + 2 * (y % 2)];
                    let mut hidden = 0.0;
                    for [u, v] in SEEDS {
                        // No branch here: half of them would be guessed wrong.
                        let qx = x as f32 + reach * (u * turn[0] - v * turn[1]) + 0.5;
                        let qy = y as f32 + reach * (u * turn[1] + v * turn[0]) + 0.5;
                        let (qx, qy) = ((qx as usize).min(width - 1), (qy as usize).min(height - 1));
                        let way = sub(self.seen[qy * width + qx].0, at);
                        let square = dot(way, way);
                        let rise = (dot(way, normal) - FLAT).max(0.0);
                        let fade = (1.0 - square * (1.0 / (REACH * REACH))).max(0.0);
                        hidden += rise * rise * fade / (square + FLAT * FLAT);
                    }
                    light[0] = (1.0 - STRENGTH / SEEDS.len() as f32 * hidden).max(DARKEST);
                }
                self.found[index] = light;
            }
        }
        self.smooth();
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
