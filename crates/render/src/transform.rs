//! Vertices on their way to the picture and to the shadow map, many at once. Each level of instructions does the same operations in the
//! same order, and none of them fuses a product with a sum: so the numbers are the same.

use fearless_simd::{Level, dispatch};

use crate::across::Across;
use crate::raster::Corner;
use crate::single::SinglePose;
use crate::single::{Vec3, dot};
use crate::view::View;

/// The vertices of a mesh as the camera sees them, by number.
#[derive(Debug, Clone, Default)]
pub(crate) struct Seen {
    /// In the camera: ahead, left, up, m.
    at: [Vec<f32>; 3],
    projected: Projected,
}

/// Places in a picture or on a map, by number of the vertex.
#[derive(Debug, Clone, Default)]
pub(crate) struct Projected {
    u: Vec<f32>,
    v: Vec<f32>,
    depth: Vec<f32>,
    /// The first pixel centre to the right (upper half) and below (lower half), within the picture; [`NOT_AHEAD`] for a vertex
    /// that the near plane cuts off.
    cells: Vec<u32>,
    /// The picture is too large for cells.
    is_large: bool,
}

const NOT_AHEAD: u32 = u32::MAX;
/// Largest side of a picture whose pixels have numbers in half a cell.
const MAX_SIDE: usize = 65_534;

/// Sides of a picture that vertices are sorted into cells of.
#[derive(Clone, Copy)]
struct Sides([f32; 2]);

impl Sides {
    fn new([width, height]: [usize; 2]) -> Self {
        Self([width, height].map(|side| side.min(MAX_SIDE) as f32))
    }

    /// Whole numbers as floats: adding this rounds to them, and puts them into the lower bits.
    const WHOLE: f32 = (1 << 23) as f32;

    #[inline(always)]
    fn first(at: f32, side: f32) -> u32 {
        let at = if at > 0.0 { at } else { 0.0 };
        let at = if at < side { at } else { side };
        let near = (at + Self::WHOLE) - Self::WHOLE;
        let first = if near < at { near + 1.0 } else { near };
        (first + Self::WHOLE).to_bits() & 0xFFFF
    }

    #[inline(always)]
    fn cell(self, corner: Corner) -> u32 {
        Self::first(corner.u, self.0[0]) << 16 | Self::first(corner.v, self.0[1])
    }
}

impl Seen {
    /// Projects positions (x, y and z of all vertices of a mesh, m) that a pose places in the world.
    pub(crate) fn project(&mut self, level: Level, positions: &[Vec<f32>; 3], pose: &SinglePose, view: &View) {
        let count = positions[0].len();
        self.at.iter_mut().for_each(|axis| axis.resize(count, 0.0));
        self.projected.resize(count);
        self.projected.is_large = view.size.iter().any(|side| *side > MAX_SIDE);
        let (at, to) = (&mut self.at, &mut self.projected);
        let sides = Sides::new(view.size);
        dispatch!(level, _simd => see(positions, pose, view, sides, at, to));
    }

    /// Distance of a vertex along the camera's axis, m.
    #[inline(always)]
    pub(crate) fn ahead(&self, vertex: usize) -> f32 {
        self.at[0][vertex]
    }

    /// Places in the picture.
    #[inline(always)]
    pub(crate) fn projected(&self) -> &Projected {
        &self.projected
    }

    pub(crate) fn at(&self, vertex: usize) -> Vec3 {
        [self.at[0][vertex], self.at[1][vertex], self.at[2][vertex]]
    }

    #[inline(always)]
    pub(crate) fn corner(&self, vertex: usize) -> Corner {
        self.projected.corner(vertex)
    }

    /// See [`Projected::may_cover`].
    #[inline(always)]
    pub(crate) fn may_cover(&self, vertices: [usize; 3]) -> bool {
        self.projected.may_cover(vertices)
    }
}

impl Projected {
    fn resize(&mut self, count: usize) {
        [&mut self.u, &mut self.v, &mut self.depth].into_iter().for_each(|list| list.resize(count, 0.0));
        self.cells.resize(count, 0);
    }

    /// u, v and depth of all vertices.
    #[inline(always)]
    pub(crate) fn columns(&self) -> [&[f32]; 3] {
        let count = self.u.len();
        [&self.u[..count], &self.v[..count], &self.depth[..count]]
    }

    /// False for a triangle that covers no pixel centre: its corners lie between the same columns or the same rows, or none of
    /// them is ahead. Most triangles of a small picture are such.
    #[inline(always)]
    pub(crate) fn may_cover(&self, vertices: [usize; 3]) -> bool {
        let [a, b, c] = vertices;
        let [a, b, c] = [self.cells[a], self.cells[b], self.cells[c]];
        let differ = (a ^ b) | (a ^ c);
        self.is_large || (differ > 0xFFFF && differ & 0xFFFF != 0)
    }

    #[inline(always)]
    pub(crate) fn corner(&self, vertex: usize) -> Corner {
        Corner { u: self.u[vertex], v: self.v[vertex], depth: self.depth[vertex] }
    }

    /// Places positions of a mesh on the shadow map.
    pub(crate) fn cast(
        &mut self,
        level: Level,
        positions: &[Vec<f32>; 3],
        pose: &SinglePose,
        map: &Across,
        size: usize,
    ) {
        self.resize(positions[0].len());
        let (to, sides) = (self, Sides::new([size; 2]));
        dispatch!(level, _simd => cast(positions, pose, map, sides, to));
    }
}

#[inline(always)]
fn find_cells(sides: Sides, u: &[f32], v: &[f32], cells: &mut [u32]) {
    let count = cells.len();
    let (u, v) = (&u[..count], &v[..count]);
    for i in 0..count {
        cells[i] = sides.cell(Corner { u: u[i], v: v[i], depth: 0.0 });
    }
}

#[inline(always)]
fn see(
    [xs, ys, zs]: &[Vec<f32>; 3],
    pose: &SinglePose,
    view: &View,
    sides: Sides,
    at: &mut [Vec<f32>; 3],
    to: &mut Projected,
) {
    let count = xs.len();
    let [ahead, left, up] = at;
    let (xs, ys, zs) = (&xs[..count], &ys[..count], &zs[..count]);
    let (ahead, left, up) = (&mut ahead[..count], &mut left[..count], &mut up[..count]);
    let (u, v, depth) = (&mut to.u[..count], &mut to.v[..count], &mut to.depth[..count]);
    for i in 0..count {
        let way = crate::single::sub(pose.point([xs[i], ys[i], zs[i]]), view.eye);
        let at = [dot(view.axes[0], way), dot(view.axes[1], way), dot(view.axes[2], way)];
        let corner = view.project(at);
        [ahead[i], left[i], up[i]] = at;
        (u[i], v[i], depth[i]) = (corner.u, corner.v, corner.depth);
    }
    let cells = &mut to.cells[..count];
    find_cells(sides, u, v, cells);
    for i in 0..count {
        cells[i] = if ahead[i] >= view.near { cells[i] } else { NOT_AHEAD };
    }
}

#[inline(always)]
fn cast([xs, ys, zs]: &[Vec<f32>; 3], pose: &SinglePose, map: &Across, sides: Sides, to: &mut Projected) {
    let count = xs.len();
    let (xs, ys, zs) = (&xs[..count], &ys[..count], &zs[..count]);
    let (u, v, depth) = (&mut to.u[..count], &mut to.v[..count], &mut to.depth[..count]);
    for i in 0..count {
        let corner = map.corner_of(pose.point([xs[i], ys[i], zs[i]]));
        (u[i], v[i], depth[i]) = (corner.u, corner.v, corner.depth);
    }
    find_cells(sides, u, v, &mut to.cells[..count]);
}

#[cfg(test)]
mod tests {
    use nalgebra::{Isometry3, Vector3};

    use super::*;
    use crate::Camera;

    /// Guards that a picture is the same on every processor: SSE2, AVX2 and the best that this one has.
    #[test]
    fn levels_of_instructions_agree_to_the_bit() {
        let number = |i: usize, k: usize| libm::sinf((i * 37 + k * 101) as f32 * 0.618) * 2.3;
        let positions = [0, 1, 2].map(|k| (0..1003).map(|i| number(i, k)).collect());
        let pose = Isometry3::new(Vector3::new(2.1, -0.3, 0.7), Vector3::new(0.3, 1.1, -0.4));
        let pose = SinglePose::new(&pose);
        let camera = Camera::look_at(Vector3::new(0.1, 0.2, 1.3), Vector3::new(2.0, 0.1, 0.4), 0.9, 1.2);
        let view = View::new(&camera, [128, 96]);
        let mut map = crate::shadow::ShadowMap::new(256);
        map.aim([0.36, 0.48, 0.8]);
        map.see([0.0; 3]);
        map.see([2.0, 1.0, 0.0]);
        assert!(map.fit());
        let bits = |level: Level| {
            let (mut seen, mut cast) = (Seen::default(), Projected::default());
            seen.project(level, &positions, &pose, &view);
            cast.cast(level, &positions, &pose, map.across(), 256);
            let of = |corner: Corner| [corner.u, corner.v, corner.depth].map(f32::to_bits);
            (0..1003)
                .map(|i| (of(seen.corner(i)), of(cast.corner(i)), seen.at(i).map(f32::to_bits)))
                .collect::<Vec<_>>()
        };
        let expected = bits(Level::baseline());
        assert_eq!(bits(Level::new()), expected);
        #[cfg(target_arch = "x86_64")]
        if let Some(avx2) = Level::new().as_avx2() {
            assert_eq!(bits(Level::Avx2(avx2)), expected);
        }
    }
}
