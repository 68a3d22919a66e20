//! Triangles from elsewhere: joined at their corners, turned outwards, and with normals.

use std::collections::BTreeMap;

use nalgebra::{Isometry3, Vector3};

use super::Mesh;
use crate::paint::Paint;

type Vec3 = Vector3<f64>;

/// Faces that meet at a larger angle than this have an edge between them, cosine; 35 degrees, ours.
const CREASE: f64 = 0.819_152;
/// Normals nearer than this to a face's own are that: a flat face is lit as one. Cosine of half a degree.
const FLAT: f64 = 0.999_962;
/// Points nearer than about this are one, m.
const SAME: f64 = 1e-6;
/// A vertex of more faces than this is the hub of a fan: its faces keep their own normals.
const MAX_FACES: usize = 64;

/// Triangles that share their vertices.
#[derive(Debug, Clone)]
pub(crate) struct Surface {
    pub(super) points: Vec<Vec3>,
    pub(super) faces: Vec<[u32; 3]>,
    /// Each edge has as many faces one way as the other, so that no inside is seen.
    is_closed: bool,
}

impl Surface {
    /// From the corners of triangles, m. What has no area is left out. A surface that is inside out is turned.
    pub(crate) fn new(triangles: &[[[f32; 3]; 3]]) -> Self {
        let mut points = Vec::new();
        let mut index_of = BTreeMap::new();
        let mut faces: Vec<[u32; 3]> = Vec::with_capacity(triangles.len());
        for triangle in triangles {
            let [a, b, c] = triangle.map(|p| {
                let key = p.map(|value| libm::round(f64::from(value) / SAME) as i64);
                *index_of.entry(key).or_insert_with(|| {
                    points.push(Vec3::from(p.map(f64::from)));
                    points.len() as u32 - 1
                })
            });
            if a != b && b != c && c != a {
                faces.push([a, b, c]);
            }
        }
        let mut surface = Self { points, faces, is_closed: false };
        surface.is_closed = surface.has_no_rim();
        surface.drop_flat_faces();
        if surface.volume() < 0.0 {
            surface.faces.iter_mut().for_each(|face| face.swap(1, 2));
        }
        surface
    }

    pub(super) fn with(&self, points: Vec<Vec3>, faces: Vec<[u32; 3]>) -> Self {
        let mut surface = Self { points, faces, is_closed: self.is_closed };
        surface.drop_flat_faces();
        surface
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.faces.is_empty()
    }

    /// Twice the area of a face along its normal.
    pub(super) fn area(&self, face: [u32; 3]) -> Vec3 {
        let [a, b, c] = face.map(|i| self.points[i as usize]);
        (b - a).cross(&(c - a))
    }

    fn drop_flat_faces(&mut self) {
        let mut faces = std::mem::take(&mut self.faces);
        faces.retain(|face| self.area(*face).norm() > 1e-14);
        self.faces = faces;
    }

    fn has_no_rim(&self) -> bool {
        let mut edges: BTreeMap<[u32; 2], i32> = BTreeMap::new();
        for [a, b, c] in &self.faces {
            for [from, to] in [[a, b], [b, c], [c, a]] {
                let (edge, way) = if from < to { ([*from, *to], 1) } else { ([*to, *from], -1) };
                *edges.entry(edge).or_default() += way;
            }
        }
        edges.values().all(|balance| *balance == 0)
    }

    /// Six times the volume within, as seen from the middle.
    fn volume(&self) -> f64 {
        let middle = self.points.iter().sum::<Vec3>() / self.points.len().max(1) as f64;
        let [a, b, c] = [0, 1, 2].map(|k| move |face: &[u32; 3]| face[k] as usize);
        let of = |face| {
            let [a, b, c] = [a(face), b(face), c(face)].map(|i| self.points[i] - middle);
            a.dot(&b.cross(&c))
        };
        self.faces.iter().map(of).sum()
    }

    /// Adds the triangles to a mesh, both sides of them where the surface is not closed.
    pub(crate) fn add_to(&self, mesh: &mut Mesh, paint: Paint) {
        let normals = self.normals();
        let mut index_of = BTreeMap::new();
        let here = Isometry3::identity();
        let sides: &[f64] = if self.is_closed { &[1.0] } else { &[1.0, -1.0] };
        for side in sides {
            for (face, normals) in self.faces.iter().zip(&normals) {
                let mut vertices = [0, 1, 2].map(|k| {
                    let normal = normals[k] * *side;
                    let key = (face[k], [normal.x, normal.y, normal.z].map(f64::to_bits));
                    *index_of.entry(key).or_insert_with(|| mesh.vertex(&here, self.points[face[k] as usize], normal))
                });
                if *side < 0.0 {
                    vertices.swap(1, 2);
                }
                mesh.triangle(vertices, paint);
            }
            mesh.casting = mesh.casting.min(mesh.triangles.len());
        }
    }

    /// A unit normal for each corner of each face: the mean of the faces around it, by their angles, up to the next edge.
    fn normals(&self) -> Vec<[Vec3; 3]> {
        let units: Vec<Vec3> = self.faces.iter().map(|face| self.area(*face).normalize()).collect();
        // The faces around each vertex, one vertex after the other.
        let mut first = vec![0_usize; self.points.len() + 1];
        self.faces.iter().flatten().for_each(|i| first[*i as usize + 1] += 1);
        for i in 1..first.len() {
            first[i] += first[i - 1];
        }
        let mut next = first.clone();
        let mut around = vec![(0_u32, 0.0_f64); 3 * self.faces.len()];
        for (index, face) in self.faces.iter().enumerate() {
            for k in 0..3 {
                let [p, q, r] = [k, (k + 1) % 3, (k + 2) % 3].map(|k| self.points[face[k] as usize]);
                let slot = &mut next[face[k] as usize];
                around[*slot] = (index as u32, angle(&(q - p), &(r - p)));
                *slot += 1;
            }
        }
        let normal = |own: &Vec3, vertex: u32| {
            let faces = &around[first[vertex as usize]..first[vertex as usize + 1]];
            if faces.len() > MAX_FACES {
                return *own;
            }
            let near = faces.iter().filter(|(face, _)| units[*face as usize].dot(own) > CREASE);
            let sum: Vec3 = near.map(|(face, angle)| units[*face as usize] * *angle).sum();
            let mean = sum.try_normalize(1e-12).unwrap_or(*own);
            if mean.dot(own) > FLAT { *own } else { mean }
        };
        self.faces.iter().zip(&units).map(|(face, own)| face.map(|vertex| normal(own, vertex))).collect()
    }
}

fn angle(a: &Vec3, b: &Vec3) -> f64 {
    libm::atan2(a.cross(b).norm(), a.dot(b))
}
