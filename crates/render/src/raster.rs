//! Scan conversion: which pixels a triangle covers, and a value interpolated over them.
//!
//! A pixel belongs to the triangle that its centre is in. Both triangles at an edge compute the edge's crossing with a
//! row from the same end, so a pixel on it goes to exactly one of them.

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

/// A triangle that faces the viewer and covers some pixel centre.
pub(crate) struct Setup {
    corners: [[f64; 2]; 3],
    inverse_area: f64,
    rows: [usize; 2],
}

impl Setup {
    /// None for a triangle that faces away, has no area, or touches no pixel centre.
    pub(crate) fn new(corners: &[Corner; 3], width: usize, height: usize) -> Option<Self> {
        let c = corners.map(|c| [f64::from(c.u), f64::from(c.v)]);
        let area = (c[1][0] - c[0][0]) * (c[2][1] - c[0][1]) - (c[2][0] - c[0][0]) * (c[1][1] - c[0][1]);
        // v grows downwards: counter-clockwise for the viewer is negative here. NaN does not face.
        let faces = area < -1e-9;
        if !faces {
            return None;
        }
        let low = |i: usize| c[0][i].min(c[1][i]).min(c[2][i]);
        let high = |i: usize| c[0][i].max(c[1][i]).max(c[2][i]);
        let (first, last) = (first_inside(low(0)), first_inside(high(0)).min(width));
        let rows = [first_inside(low(1)), first_inside(high(1)).min(height)];
        (first < last && rows[0] < rows[1]).then(|| Self { corners: c, inverse_area: 1.0 / area, rows })
    }

    /// The plane through values at the corners.
    pub(crate) fn plane(&self, values: [f32; 3]) -> Plane {
        let [a, b, c] = self.corners;
        let [f0, f1, f2] = values.map(f64::from);
        let (d1, d2) = ((f1 - f0) * self.inverse_area, (f2 - f0) * self.inverse_area);
        let right = d1 * (c[1] - a[1]) - d2 * (b[1] - a[1]);
        let down = d2 * (b[0] - a[0]) - d1 * (c[0] - a[0]);
        Plane { slope: [right as f32, down as f32], origin: (f0 - right * a[0] - down * a[1]) as f32 }
    }

    /// Calls `row(y, first, last)` for each row with covered pixels, `last` excluded.
    pub(crate) fn rows(&self, width: usize, mut row: impl FnMut(usize, usize, usize)) {
        let [a, b, c] = self.corners;
        let edges = [Edge::new(a, b), Edge::new(b, c), Edge::new(c, a)];
        for y in self.rows[0]..self.rows[1] {
            let v = y as f64;
            let (mut left, mut right) = (0.0_f64, width as f64);
            for edge in &edges {
                match edge.side {
                    Side::Left => left = left.max(edge.at(v)),
                    Side::Right => right = right.min(edge.at(v)),
                    Side::Level => {}
                }
            }
            let (first, last) = (first_inside(left), first_inside(right).min(width));
            if first < last {
                row(y, first, last);
            }
        }
    }
}

#[derive(Clone, Copy)]
enum Side {
    Left,
    Right,
    Level,
}

struct Edge {
    top: [f64; 2],
    slope: f64,
    side: Side,
}

impl Edge {
    fn new(from: [f64; 2], to: [f64; 2]) -> Self {
        let down = to[1] - from[1];
        let side = if down > 0.0 {
            Side::Left
        } else if down < 0.0 {
            Side::Right
        } else {
            Side::Level
        };
        let (top, bottom) = if down > 0.0 { (from, to) } else { (to, from) };
        Self { top, slope: (bottom[0] - top[0]) / (bottom[1] - top[1]), side }
    }

    #[inline]
    fn at(&self, v: f64) -> f64 {
        self.top[0] + (v - self.top[1]) * self.slope
    }
}

/// The first whole number, at least 0, that is not below `x`.
#[inline]
fn first_inside(x: f64) -> usize {
    // A cast cuts towards zero and takes what is below zero to it.
    let whole = x as usize;
    if (whole as f64) < x { whole + 1 } else { whole }
}

/// Writes a triangle's depth where it is nearest, and its number next to it.
pub(crate) fn fill(setup: &Setup, plane: &Plane, width: usize, depth: &mut [f32], ids: Option<(&mut [u32], u32)>) {
    match ids {
        Some((ids, id)) => setup.rows(width, |y, first, last| {
            let range = y * width + first..y * width + last;
            let start = plane.origin + plane.slope[1] * y as f32;
            for (k, (z, i)) in depth[range.clone()].iter_mut().zip(&mut ids[range]).enumerate() {
                let value = start + plane.slope[0] * (first + k) as f32;
                if value > *z {
                    *z = value;
                    *i = id;
                }
            }
        }),
        None => setup.rows(width, |y, first, last| {
            let start = plane.origin + plane.slope[1] * y as f32;
            for (k, z) in depth[y * width + first..y * width + last].iter_mut().enumerate() {
                let value = start + plane.slope[0] * (first + k) as f32;
                *z = if value > *z { value } else { *z };
            }
        }),
    }
}
