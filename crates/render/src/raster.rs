//! Scan conversion: which pixels a triangle covers, and a value interpolated over them.
//!
//! A pixel belongs to the triangle that its centre is in. Both triangles at an edge compute the edge's crossing with a
//! row from the same end, so a pixel on it goes to exactly one of them.
//!
//! Four triangles and eight pixels are done at once; each level of instructions does the same operations in the same order, and none
//! fuses a product with a sum.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x8, f64x4, mask32x8};

/// A projected vertex: position in pixels, where whole numbers are pixel centres, and the value that the depth test
/// compares; the larger value wins.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Corner {
    pub u: f32,
    pub v: f32,
    pub depth: f32,
}

/// A value that is linear over the picture.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Plane {
    /// Change to the right and downwards, per pixel.
    pub slope: [f32; 2],
    /// Value at the first pixel's centre.
    pub origin: f32,
}

impl Plane {
    #[inline]
    pub(crate) fn at(&self, u: f32, v: f32) -> f32 {
        self.origin + self.slope[0] * u + self.slope[1] * v
    }
}

/// Numbers that a buffer has beyond the picture, so that the last pixels of it are eight as well.
pub(crate) const SPARE: usize = LANES;
/// Pixels that are written at once.
pub(crate) const LANES: usize = 8;
/// Columns and rows of eight pixels.
pub(crate) type Places = [[u32; LANES]; 2];
/// Triangles whose edges are found at once, and rows whose ends are.
const FOUR: usize = 4;

/// Where triangles are drawn.
pub(crate) trait Canvas {
    /// Width and height, pixels.
    fn size(&self) -> [usize; 2];

    /// Writes the values of those of eight pixels, from an index on, that are `inside` and where they are the largest yet; true
    /// where there are such.
    fn put<S: Simd>(&mut self, simd: S, at: usize, value: f32x8<S>, inside: mask32x8<S>) -> bool;

    /// Ends a triangle that is the nearest somewhere; it has that place in the list.
    fn seen<S: Simd>(&mut self, simd: S, place: u32, setup: &Setup, depths: [f32; 3]);
}

/// A triangle that faces the viewer.
pub(crate) struct Setup {
    corners: [[f64; 2]; 3],
    inverse_area: f64,
}

impl Setup {
    /// The planes through three values at the corners.
    #[inline(always)]
    pub(crate) fn planes<S: Simd>(&self, simd: S, [a, b, c]: [[f32; 3]; 3]) -> [Plane; 3] {
        let wide = |[x, y, z]: [f32; 3]| f64x4::from_slice(simd, &[x.into(), y.into(), z.into(), 0.0]);
        let splat = |value: f64| f64x4::splat(simd, value);
        let corners = [splat2(simd, self.corners[0]), splat2(simd, self.corners[1]), splat2(simd, self.corners[2])];
        let [right, down, origin] = planes(corners, splat(self.inverse_area), [wide(a), wide(b), wide(c)]);
        let (right, down, origin): ([f64; 4], [f64; 4], [f64; 4]) = (right.into(), down.into(), origin.into());
        let plane = |i: usize| Plane { slope: [right[i] as f32, down[i] as f32], origin: origin[i] as f32 };
        [plane(0), plane(1), plane(2)]
    }
}

#[inline(always)]
fn splat2<S: Simd>(simd: S, [u, v]: [f64; 2]) -> [f64x4<S>; 2] {
    [f64x4::splat(simd, u), f64x4::splat(simd, v)]
}

/// Slopes to the right and downwards, and values at the first pixel, of planes through values at corners.
#[inline(always)]
fn planes<S: Simd>(
    [a, b, c]: [[f64x4<S>; 2]; 3],
    inverse_area: f64x4<S>,
    [f0, f1, f2]: [f64x4<S>; 3],
) -> [f64x4<S>; 3] {
    let (d1, d2) = ((f1 - f0) * inverse_area, (f2 - f0) * inverse_area);
    let right = d1 * (c[1] - a[1]) - d2 * (b[1] - a[1]);
    let down = d2 * (b[0] - a[0]) - d1 * (c[0] - a[0]);
    [right, down, f0 - right * a[0] - down * a[1]]
}

/// Up to four triangles that face the viewer, to be drawn in that order.
#[derive(Debug, Clone, Default)]
pub(crate) struct Four {
    u: [[f32; FOUR]; 3],
    v: [[f32; FOUR]; 3],
    depth: [[f32; FOUR]; 3],
    /// The number of each that its canvas knows it by.
    name: [u32; FOUR],
    count: usize,
}

impl Four {
    /// Takes in a triangle, which must be drawn later, if it faces the viewer and has an area; true once there are four.
    #[inline(always)]
    pub(crate) fn push(&mut self, [u, v, depth]: [&[f32]; 3], [a, b, c]: [usize; 3], name: u32) -> bool {
        let (u, v, depth) = ([u[a], u[b], u[c]], [v[a], v[b], v[c]], [depth[a], depth[b], depth[c]]);
        let [au, bu, cu] = [f64::from(u[0]), f64::from(u[1]), f64::from(u[2])];
        let [av, bv, cv] = [f64::from(v[0]), f64::from(v[1]), f64::from(v[2])];
        // v grows downwards: counter-clockwise for the viewer is negative here. NaN does not face.
        let faces = (bu - au) * (cv - av) - (cu - au) * (bv - av) < -1e-9;
        if !faces {
            return false;
        }
        let lane = self.count % FOUR;
        for k in 0..3 {
            (self.u[k][lane], self.v[k][lane], self.depth[k][lane]) = (u[k], v[k], depth[k]);
        }
        self.name[lane] = name;
        self.count = lane + 1;
        self.count == FOUR
    }

    #[inline(always)]
    fn corners<S: Simd>(&self, simd: S) -> [[f64x4<S>; 2]; 3] {
        let corner = |k: usize| [doubles(simd, self.u[k]), doubles(simd, self.v[k])];
        [corner(0), corner(1), corner(2)]
    }
}

#[inline(always)]
fn doubles<S: Simd>(simd: S, [a, b, c, d]: [f32; FOUR]) -> f64x4<S> {
    f64x4::from_slice(simd, &[a.into(), b.into(), c.into(), d.into()])
}

/// Twice the areas of triangles, negative where they face the viewer.
#[inline(always)]
fn areas<S: Simd>(c: &[[f64x4<S>; 2]; 3]) -> f64x4<S> {
    (c[1][0] - c[0][0]) * (c[2][1] - c[0][1]) - (c[2][0] - c[0][0]) * (c[1][1] - c[0][1])
}

/// Draws the triangles that wait, and takes them out.
#[inline(always)]
pub(crate) fn draw<S: Simd>(simd: S, four: &mut Four, canvas: &mut impl Canvas) {
    let count = std::mem::take(&mut four.count);
    if count == 0 {
        return;
    }
    let [width, height] = canvas.size();
    let splat = |value: f64| f64x4::splat(simd, value);
    let corners = four.corners(simd);
    let inverse_area = splat(1.0) / areas(&corners);
    let depths = [doubles(simd, four.depth[0]), doubles(simd, four.depth[1]), doubles(simd, four.depth[2])];
    let [right, down, origin] = planes(corners, inverse_area, depths);
    let edges = Edges::new(simd, &corners);

    let [a, b, c] = [corners[0][1], corners[1][1], corners[2][1]];
    let (end, bottom) = (splat(width as f64), splat(height as f64));
    let low = firsts(simd, lesser(lesser(a, b), c), bottom);
    let high = firsts(simd, greater(greater(a, b), c), bottom);
    let mut most = 0;
    for k in 0..count {
        most = most.max(high[k].saturating_sub(low[k]));
    }
    let top = f64x4::from_slice(simd, &[low[0] as f64, low[1] as f64, low[2] as f64, low[3] as f64]);

    let [right, down, origin, inverse_area]: [[f64; FOUR]; 4] =
        [right.into(), down.into(), origin.into(), inverse_area.into()];
    let columns = f32x8::from_slice(simd, &[0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]);
    let eight = f32x8::splat(simd, LANES as f32);

    // Small triangles have few rows: those of all four are found together. Each triangle is drawn to its end before the next.
    let mut spans = [[[0_usize; 2]; FOUR]; FOUR];
    for (row, spans) in spans.iter_mut().enumerate().take(most) {
        let (first, last) = edges.ends(simd, top + splat(row as f64), end);
        for k in 0..FOUR {
            spans[k] = [first[k], last[k]];
        }
    }
    for k in 0..count {
        let [slope, steep, start] = [right[k] as f32, down[k] as f32, origin[k] as f32];
        let slope = f32x8::splat(simd, slope);
        let mut seen = false;
        let mut more = [[0_usize; 2]; FOUR];
        for y in low[k]..high[k] {
            let row = y - low[k];
            let [first, last] = if row < FOUR {
                spans[row][k]
            } else {
                if row.is_multiple_of(FOUR) {
                    let rows = f64x4::from_slice(simd, &[0.0, 1.0, 2.0, 3.0]);
                    let (first, last) = edges.of(simd, k).ends(simd, splat(y as f64) + rows, end);
                    for k in 0..FOUR {
                        more[k] = [first[k], last[k]];
                    }
                }
                more[row % FOUR]
            };
            if first >= last {
                continue;
            }
            let start = f32x8::splat(simd, start + steep * y as f32);
            let end = f32x8::splat(simd, last as f32);
            let mut x = f32x8::splat(simd, first as f32) + columns;
            let mut at = y * width + first;
            loop {
                seen |= canvas.put(simd, at, start + slope * x, x.simd_lt(end));
                at += LANES;
                if at >= y * width + last {
                    break;
                }
                x += eight;
            }
        }
        if seen {
            let corner = |i: usize| [f64::from(four.u[i][k]), f64::from(four.v[i][k])];
            let setup = Setup { corners: [corner(0), corner(1), corner(2)], inverse_area: inverse_area[k] };
            canvas.seen(simd, four.name[k], &setup, [four.depth[0][k], four.depth[1][k], four.depth[2][k]]);
        }
    }
}

#[inline(always)]
fn lesser<S: Simd>(a: f64x4<S>, b: f64x4<S>) -> f64x4<S> {
    a.simd_lt(b).select(a, b)
}

#[inline(always)]
fn greater<S: Simd>(a: f64x4<S>, b: f64x4<S>) -> f64x4<S> {
    a.simd_gt(b).select(a, b)
}

/// The first whole number, at least 0 and at most `end`, that is not below each of four.
#[inline(always)]
fn firsts<S: Simd>(simd: S, at: f64x4<S>, end: f64x4<S>) -> [usize; FOUR] {
    // Adding this rounds to a whole number and leaves it in the lower bits.
    let whole = f64x4::splat(simd, (1_u64 << 52) as f64);
    let at = lesser(greater(at, f64x4::splat(simd, 0.0)), end);
    let near = (at + whole) - whole;
    let first = near.simd_lt(at).select(near + f64x4::splat(simd, 1.0), near) + whole;
    let [a, b, c, d]: [f64; FOUR] = first.into();
    let whole = |number: f64| number.to_bits() as u32 as usize;
    [whole(a), whole(b), whole(c), whole(d)]
}

/// The three edges of four triangles, or of one, four times.
struct Edges<S: Simd> {
    /// Upper ends across where an edge bounds its triangle on the left, else no bound; and on the right.
    left: [f64x4<S>; 3],
    right: [f64x4<S>; 3],
    /// Upper ends down.
    top: [f64x4<S>; 3],
    slope: [f64x4<S>; 3],
}

impl<S: Simd> Edges<S> {
    #[inline(always)]
    fn new(simd: S, corners: &[[f64x4<S>; 2]; 3]) -> Self {
        let zero = f64x4::splat(simd, 0.0);
        let [lowest, highest] = [f64x4::splat(simd, f64::NEG_INFINITY), f64x4::splat(simd, f64::INFINITY)];
        let mut edges = Self { left: [zero; 3], right: [zero; 3], top: [zero; 3], slope: [zero; 3] };
        for k in 0..3 {
            let (from, to) = (corners[k], corners[(k + 1) % 3]);
            let down = to[1] - from[1];
            let (left, right) = (down.simd_gt(zero), down.simd_lt(zero));
            let top = [left.select(from[0], to[0]), left.select(from[1], to[1])];
            let bottom = [left.select(to[0], from[0]), left.select(to[1], from[1])];
            edges.left[k] = left.select(top[0], lowest);
            edges.right[k] = right.select(top[0], highest);
            edges.top[k] = top[1];
            edges.slope[k] = (bottom[0] - top[0]) / (bottom[1] - top[1]);
        }
        edges
    }

    /// Those of one triangle.
    #[inline(always)]
    fn of(&self, simd: S, triangle: usize) -> Self {
        let one = |four: f64x4<S>| f64x4::splat(simd, four.as_slice()[triangle]);
        let three = |of: &[f64x4<S>; 3]| [one(of[0]), one(of[1]), one(of[2])];
        Self { left: three(&self.left), right: three(&self.right), top: three(&self.top), slope: three(&self.slope) }
    }

    /// The first pixel of a row and the one after its last; `v` are the rows.
    #[inline(always)]
    fn ends(&self, simd: S, v: f64x4<S>, end: f64x4<S>) -> ([usize; FOUR], [usize; FOUR]) {
        let (mut left, mut right) = (f64x4::splat(simd, 0.0), end);
        for k in 0..3 {
            // A level edge has no slope; no number, or an unbounded one, bounds nothing.
            let across = (v - self.top[k]) * self.slope[k];
            left = greater(self.left[k] + across, left);
            right = lesser(self.right[k] + across, right);
        }
        (firsts(simd, left, end), firsts(simd, right, end))
    }
}
