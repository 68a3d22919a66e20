//! Ambient occlusion: how much of the dome a pixel sees past its neighbours.

use crate::shade::{Vec3, dot, sub};

/// Reach of the occlusion, m.
const REACH: f32 = 0.35;
/// Largest reach in the picture, as a share of its height.
const LARGEST: f32 = 0.10;
/// How dark it gets, and the least light that is left.
const STRENGTH: f32 = 2.4;
const DARKEST: f32 = 0.15;
/// Neighbours that rise less than this above the surface hide nothing, m.
const FLAT: f32 = 0.004;
/// Neighbours looked at: a sunflower's first eight seeds. Each pixel of a block of two by two looks another way.
const SEEDS: [[f32; 2]; 8] = [
    [0.250, 0.000],
    [-0.319, 0.292],
    [0.049, -0.557],
    [0.402, 0.525],
    [-0.739, -0.130],
    [0.700, -0.445],
    [-0.234, 0.870],
    [-0.446, -0.859],
];
const TURNS: [[f32; 2]; 4] = [[1.0, 0.0], [0.0, 1.0], [0.7071, 0.7071], [-0.7071, 0.7071]];

/// The light of the dome that is left, on every other pixel of every other row.
#[derive(Debug, Clone)]
pub(crate) struct Occlusion {
    width: usize,
    height: usize,
    /// What is visible: point, and inverse of its depth (0 for the background).
    seen: Vec<(Vec3, f32)>,
    /// Light left, and the inverse depth it was found at.
    light: Vec<[f32; 2]>,
}

impl Occlusion {
    pub(crate) fn new(width: usize, height: usize) -> Self {
        let (width, height) = (width.div_ceil(2), height.div_ceil(2));
        let pixels = width * height;
        Self { width, height, seen: vec![([0.0; 3], 0.0); pixels], light: vec![[1.0, 0.0]; pixels] }
    }

    /// Fills it. For a pixel, `point` is what is visible and the inverse of its depth, and `normal` its unit normal; both
    /// are None for the background. `focal` is in pixels.
    pub(crate) fn find(
        &mut self,
        focal: f32,
        point: impl Fn(usize, usize) -> Option<(Vec3, f32)>,
        normal: impl Fn(usize, usize) -> Option<Vec3>,
    ) {
        let (width, height) = (self.width, self.height);
        for (at, seen) in self.seen.iter_mut().enumerate() {
            *seen = point(2 * (at % width), 2 * (at / width)).unwrap_or_default();
        }
        let (right, bottom) = (width as f32, height as f32);
        let largest = LARGEST * bottom;
        for y in 0..height {
            for x in 0..width {
                let index = y * width + x;
                let (at, inverse) = self.seen[index];
                let mut light = [1.0, inverse];
                if let Some(normal) = normal(2 * x, 2 * y) {
                    let reach = (0.5 * REACH * focal * inverse).min(largest);
                    let turn = TURNS[(x % 2) + 2 * (y % 2)];
                    let mut hidden = 0.0;
                    for [u, v] in SEEDS {
                        let qx = x as f32 + reach * (u * turn[0] - v * turn[1]) + 0.5;
                        let qy = y as f32 + reach * (u * turn[1] + v * turn[0]) + 0.5;
                        if !(qx >= 0.0 && qy >= 0.0 && qx < right && qy < bottom) {
                            continue;
                        }
                        let (other, depth) = self.seen[qy as usize * width + qx as usize];
                        let way = sub(other, at);
                        let square = dot(way, way);
                        let rise = dot(way, normal) - FLAT;
                        if rise > 0.0 && square < REACH * REACH && depth > 0.0 {
                            hidden += rise * rise * (1.0 - square / (REACH * REACH)) / (square + FLAT * FLAT);
                        }
                    }
                    light[0] = (1.0 - STRENGTH / SEEDS.len() as f32 * hidden).max(DARKEST);
                }
                self.light[index] = light;
            }
        }
    }

    /// Light left at a pixel whose inverse depth is given: the mean of its neighbours at about its depth.
    pub(crate) fn at(&self, x: usize, y: usize, inverse: f32) -> f32 {
        let left = (x / 2).saturating_sub(1 - x % 2).min(self.width.saturating_sub(2));
        let top = (y / 2).saturating_sub(1 - y % 2).min(self.height.saturating_sub(2));
        let (right, bottom) = ((left + 1).min(self.width - 1), (top + 1).min(self.height - 1));
        let tolerance = 0.06 * inverse;
        let (mut sum, mut weights) = (0.0, 0.0);
        for at in [(top, left), (top, right), (bottom, left), (bottom, right)] {
            let [light, depth] = self.light[at.0 * self.width + at.1];
            let weight = if (depth - inverse).abs() < tolerance { 1.0 } else { 1e-3 };
            sum += weight * light;
            weights += weight;
        }
        sum / weights
    }
}
