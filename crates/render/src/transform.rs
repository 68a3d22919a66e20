//! Vertices on their way to the picture and to the shadow map, many at once. Each level of instructions does the same operations in the
//! same order, and none of them fuses a product with a sum: so the numbers are the same.

use fearless_simd::{Level, dispatch};

use crate::raster::Corner;
use crate::shade::{Vec3, dot};
use crate::shadow::Across;
use crate::view::{SinglePose, View};

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
}

impl Seen {
    /// Projects positions (x, y and z of all vertices of a mesh, m) that a pose places in the world.
    pub(crate) fn project(&mut self, level: Level, positions: &[Vec<f32>; 3], pose: &SinglePose, view: &View) {
        let count = positions[0].len();
        self.at.iter_mut().for_each(|axis| axis.resize(count, 0.0));
        self.projected.resize(count);
        let (at, to) = (&mut self.at, &mut self.projected);
        dispatch!(level, _simd => see(positions, pose, view, at, to));
    }

    /// Distance of a vertex along the camera's axis, m.
    #[inline]
    pub(crate) fn ahead(&self, vertex: usize) -> f32 {
        self.at[0][vertex]
    }

    pub(crate) fn at(&self, vertex: usize) -> Vec3 {
        [self.at[0][vertex], self.at[1][vertex], self.at[2][vertex]]
    }

    #[inline]
    pub(crate) fn corner(&self, vertex: usize) -> Corner {
        self.projected.corner(vertex)
    }
}

impl Projected {
    fn resize(&mut self, count: usize) {
        [&mut self.u, &mut self.v, &mut self.depth].into_iter().for_each(|list| list.resize(count, 0.0));
    }

    #[inline]
    pub(crate) fn corner(&self, vertex: usize) -> Corner {
        Corner { u: self.u[vertex], v: self.v[vertex], depth: self.depth[vertex] }
    }

    /// Places positions of a mesh on the shadow map.
    pub(crate) fn cast(&mut self, level: Level, positions: &[Vec<f32>; 3], pose: &SinglePose, map: &Across) {
        self.resize(positions[0].len());
        let to = self;
        dispatch!(level, _simd => cast(positions, pose, map, to));
    }
}

#[inline(always)]
fn see([xs, ys, zs]: &[Vec<f32>; 3], pose: &SinglePose, view: &View, at: &mut [Vec<f32>; 3], to: &mut Projected) {
    let count = xs.len();
    let [ahead, left, up] = at;
    let (xs, ys, zs) = (&xs[..count], &ys[..count], &zs[..count]);
    let (ahead, left, up) = (&mut ahead[..count], &mut left[..count], &mut up[..count]);
    let (u, v, depth) = (&mut to.u[..count], &mut to.v[..count], &mut to.depth[..count]);
    for i in 0..count {
        let way = crate::shade::sub(pose.point([xs[i], ys[i], zs[i]]), view.eye);
        let at = [dot(view.axes[0], way), dot(view.axes[1], way), dot(view.axes[2], way)];
        let corner = view.project(at);
        [ahead[i], left[i], up[i]] = at;
        (u[i], v[i], depth[i]) = (corner.u, corner.v, corner.depth);
    }
}

#[inline(always)]
fn cast([xs, ys, zs]: &[Vec<f32>; 3], pose: &SinglePose, map: &Across, to: &mut Projected) {
    let count = xs.len();
    let (xs, ys, zs) = (&xs[..count], &ys[..count], &zs[..count]);
    let (u, v, depth) = (&mut to.u[..count], &mut to.v[..count], &mut to.depth[..count]);
    for i in 0..count {
        let corner = map.corner_of(pose.point([xs[i], ys[i], zs[i]]));
        (u[i], v[i], depth[i]) = (corner.u, corner.v, corner.depth);
    }
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
            cast.cast(level, &positions, &pose, map.across());
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
