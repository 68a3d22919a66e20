//! Solids of which everything is made.

use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, TAU};

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

use super::{Detail, Mesh};
use crate::paint::Paint;

/// A point of a profile that turns about z: height, radius, and the normal's direction in that half plane.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Rim {
    pub z: f64,
    pub r: f64,
    pub normal: [f64; 2],
}

impl Rim {
    /// `normal` is (along z, outwards).
    pub(crate) fn new(z: f64, r: f64, normal: [f64; 2]) -> Self {
        Self { z, r, normal }
    }
}

impl Mesh {
    /// A surface of revolution about z. The profile goes upwards on the outside.
    pub(crate) fn revolve(&mut self, pose: &Isometry3<f64>, profile: &[Rim], segments: u32, paint: Paint) {
        let segments = self.segments(segments);
        let mut below: Option<Vec<u32>> = None;
        for rim in profile {
            let ring: Vec<u32> = (0..segments)
                .map(|k| {
                    let angle = TAU * f64::from(k) / f64::from(segments);
                    let (c, s) = (libm::cos(angle), libm::sin(angle));
                    let normal = Vector3::new(rim.normal[1] * c, rim.normal[1] * s, rim.normal[0]);
                    self.vertex(pose, Vector3::new(rim.r * c, rim.r * s, rim.z), normal)
                })
                .collect();
            if let Some(below) = &below {
                for k in 0..segments as usize {
                    let next = (k + 1) % segments as usize;
                    self.quad([below[k], below[next], ring[next], ring[k]], paint);
                }
            }
            below = Some(ring);
        }
    }

    /// A ball swept from one point to another while its radius changes.
    pub(crate) fn bar(
        &mut self,
        pose: &Isometry3<f64>,
        [from, to]: [Vector3<f64>; 2],
        [r0, r1]: [f64; 2],
        segments: u32,
        paint: Paint,
    ) {
        let length = (to - from).norm();
        // The cone that touches both balls leaves them at this angle from their equators.
        let tilt = if length > 0.0 { libm::asin(((r0 - r1) / length).clamp(-1.0, 1.0)) } else { 0.0 };
        let steps = (self.segments(segments) / 4).max(2);
        let mut profile = Vec::new();
        for (center, radius, low, high) in [(0.0, r0, -FRAC_PI_2, tilt), (length, r1, tilt, FRAC_PI_2)] {
            for k in 0..=steps {
                let angle = low + (high - low) * f64::from(k) / f64::from(steps);
                let (c, s) = (libm::cos(angle), libm::sin(angle));
                profile.push(Rim::new(center + radius * s, radius * c.max(0.0), [s, c]));
            }
        }
        let pose = pose * Isometry3::from_parts(Translation3::from(from), z_to(&(to - from)));
        self.revolve(&pose, &profile, segments, paint);
    }

    /// A cylinder about `axis` with rounded edges; `half` is half its length.
    pub(crate) fn disc(
        &mut self,
        pose: &Isometry3<f64>,
        center: Vector3<f64>,
        axis: &Vector3<f64>,
        [radius, half]: [f64; 2],
        segments: u32,
        paint: Paint,
    ) {
        let round = 0.25 * radius.min(half);
        let mut profile = vec![Rim::new(-half, 0.0, [-1.0, 0.0])];
        for (side, angles) in [(-1.0, [-FRAC_PI_2, 0.0]), (1.0, [0.0, FRAC_PI_2])] {
            let steps = if self.detail == Detail::Coarse { 1 } else { 2 };
            for k in 0..=steps {
                let angle = angles[0] + (angles[1] - angles[0]) * f64::from(k) / f64::from(steps);
                let (c, s) = (libm::cos(angle), libm::sin(angle));
                profile.push(Rim::new(side * (half - round) + round * s, radius - round + round * c, [s, c]));
            }
        }
        profile.push(Rim::new(half, 0.0, [1.0, 0.0]));
        let pose = pose * Isometry3::from_parts(Translation3::from(center), z_to(axis));
        self.revolve(&pose, &profile, segments, paint);
    }

    /// An ellipsoid with its axes along the pose's.
    pub(crate) fn egg(
        &mut self,
        pose: &Isometry3<f64>,
        center: Vector3<f64>,
        radii: Vector3<f64>,
        segments: u32,
        paint: Paint,
    ) {
        let first = self.positions.len();
        let steps = self.segments(segments) / 2;
        let profile: Vec<Rim> = (0..=steps)
            .map(|k| {
                let angle = -FRAC_PI_2 + 2.0 * FRAC_PI_2 * f64::from(k) / f64::from(steps);
                let (c, s) = (libm::cos(angle).max(0.0), libm::sin(angle));
                Rim::new(s, c, [s, c])
            })
            .collect();
        self.revolve(&Isometry3::identity(), &profile, segments, paint);
        for i in first..self.positions.len() {
            let unit = Vector3::from(self.positions[i].map(f64::from));
            let p = pose * nalgebra::Point3::from(center + unit.component_mul(&radii));
            let n = pose.rotation * unit.component_div(&radii).normalize();
            self.positions[i] = [p.x as f32, p.y as f32, p.z as f32];
            self.normals[i] = [n.x as f32, n.y as f32, n.z as f32];
        }
    }

    /// A box with sharp edges.
    pub(crate) fn cuboid(&mut self, pose: &Isometry3<f64>, half: Vector3<f64>, paint: Paint) {
        for axis in 0..3 {
            for side in [-1.0, 1.0] {
                self.cuboid_face(pose, half, axis, side, paint);
            }
        }
    }

    /// One face of a box: that on the `side` (-1 or 1) of an axis.
    pub(crate) fn cuboid_face(
        &mut self,
        pose: &Isometry3<f64>,
        half: Vector3<f64>,
        axis: usize,
        side: f64,
        paint: Paint,
    ) {
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        let mut normal = Vector3::zeros();
        normal[axis] = side;
        let corners = [[-1.0, -side], [1.0, -side], [1.0, side], [-1.0, side]].map(|[at_u, at_v]| {
            let mut p = half * side;
            p[u] = at_u * half[u];
            p[v] = at_v * half[v];
            self.vertex(pose, p, normal)
        });
        self.quad(corners, paint);
    }

    /// A box with rounded edges in `steps` steps. `taper` widens x and y by that share at the top and narrows them at the
    /// bottom.
    pub(crate) fn block(
        &mut self,
        pose: &Isometry3<f64>,
        half: Vector3<f64>,
        round: f64,
        steps: u32,
        taper: f64,
        paint: Paint,
    ) {
        let steps = if self.detail == Detail::Coarse { 1 } else { steps };
        let round = round.min(half.min());
        let core = half - Vector3::repeat(round);
        // Rounding angle and side of the core, across a face.
        let stops: Vec<(f64, f64)> = [-1.0, 1.0]
            .into_iter()
            .flat_map(|side| {
                (0..=steps).map(move |k| {
                    let share = f64::from(k) / f64::from(steps);
                    (FRAC_PI_4 * if side < 0.0 { share - 1.0 } else { share }, side)
                })
            })
            .collect();
        let slope = taper / half.z;
        for axis in 0..3 {
            let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
            for side in [-1.0, 1.0] {
                let mut grid = Vec::with_capacity(stops.len() * stops.len());
                for &(angle_v, side_v) in &stops {
                    for &(angle_u, side_u) in &stops {
                        let mut n = Vector3::zeros();
                        (n[axis], n[u], n[v]) = (side, libm::tan(angle_u), libm::tan(angle_v));
                        let n = n.normalize();
                        let mut p = round * n;
                        p[axis] += side * core[axis];
                        p[u] += side_u * core[u];
                        p[v] += side_v * core[v];
                        let wide = 1.0 + slope * p.z;
                        let tilted = Vector3::new(n.x / wide, n.y / wide, n.z - slope * (p.x * n.x + p.y * n.y) / wide);
                        grid.push(self.vertex(pose, Vector3::new(p.x * wide, p.y * wide, p.z), tilted));
                    }
                }
                let row = stops.len();
                for j in 0..row - 1 {
                    for i in 0..row - 1 {
                        let [a, b, c, d] = [j * row + i, j * row + i + 1, (j + 1) * row + i + 1, (j + 1) * row + i];
                        let quad = if side > 0.0 { [a, b, c, d] } else { [a, d, c, b] };
                        self.quad(quad.map(|at| grid[at]), paint);
                    }
                }
            }
        }
    }
}

/// The shortest turn that takes +z to a direction.
pub(crate) fn z_to(direction: &Vector3<f64>) -> UnitQuaternion<f64> {
    UnitQuaternion::rotation_between(&Vector3::z(), direction)
        .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI))
}
