//! Faces and edges of a cloud of points, and its checks.

use std::collections::BTreeMap;

use parry3d_f64::math::Vector;
use parry3d_f64::transformation::try_convex_hull;

use super::{Edge, Face, Hull};
use crate::check::{check_finite, check_value};
use crate::error::ModelError;
use crate::spatial::V3;

/// Most vertices of a hull. Contact between two hulls takes time by the product of their edges.
pub const MAX_VERTICES: usize = 128;
/// Lengths that a hull may have, m.
const LENGTHS: [f64; 2] = [1e-3, 1e3];
/// Least thickness of a hull, as a part of its length.
const MIN_THICKNESS: f64 = 1e-3;
/// Triangles whose corners are nearer than this to one plane, as a part of the hull's length, are one face.
const FLATNESS: f64 = 1e-8;

impl Hull {
    /// The convex hull of points in m, of which those inside are left out. `name` is for the message of an error.
    ///
    /// # Errors
    /// Fewer than 4 or more than [`MAX_VERTICES`] points, a number that is not finite, a length out of range, or points
    /// that nearly lie in a plane.
    pub fn new(name: &str, points: &[V3]) -> Result<Self, ModelError> {
        let structure = |reason: String| ModelError::Structure { part: "hull", name: name.into(), reason };
        if !(4..=MAX_VERTICES).contains(&points.len()) {
            return Err(structure(format!("vertices: {} were given; give 4 to {MAX_VERTICES}", points.len())));
        }
        for point in points {
            check_finite("hull", name, "vertices", point.as_slice())?;
        }
        let (low, high) = points.iter().fold((points[0], points[0]), |(low, high), p| (low.inf(p), high.sup(p)));
        let (length, farthest) = ((high - low).norm(), low.amax().max(high.amax()));
        let in_range = length >= LENGTHS[0] && farthest <= LENGTHS[1];
        check_value("hull", name, "length of the vertices' box", length, in_range, "it must be between 1 mm and 1 km")?;
        let flat =
            || structure("vertices: their hull is nearly flat; give at least 4 that do not lie in a plane".into());
        let cloud: Vec<Vector> = points.iter().map(|p| Vector::new(p.x, p.y, p.z)).collect();
        let (vertices, triangles) = try_convex_hull(&cloud).map_err(|_| flat())?;
        let vertices: Vec<V3> = vertices.iter().map(|v| V3::new(v.x, v.y, v.z)).collect();
        let loops = face_loops(&vertices, &triangles, FLATNESS * length);
        let hull = loops.and_then(|loops| Self::from_faces(vertices, &loops));
        let hull = hull.filter(|hull| hull.is_convex(1e-6 * length)).ok_or_else(flat)?;
        if hull.faces.iter().all(|face| hull.depth(face) >= MIN_THICKNESS * length) { Ok(hull) } else { Err(flat()) }
    }

    /// A box about the origin; none if it is too small to have faces.
    pub(crate) fn cuboid(half: &V3) -> Option<Self> {
        let corner = |k: usize| {
            let sign = |axis: usize| if k >> axis & 1 == 0 { -1.0 } else { 1.0 };
            half.component_mul(&V3::new(sign(0), sign(1), sign(2)))
        };
        let faces = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
        let faces = faces.map(|face: [u16; 4]| face.to_vec());
        Self::from_faces((0..8).map(corner).collect(), &faces)
    }

    /// None unless the faces make a closed surface.
    fn from_faces(vertices: Vec<V3>, loops: &[Vec<u16>]) -> Option<Self> {
        let mut hull = Self {
            inside: V3::zeros(),
            radius: vertices.iter().map(V3::norm).fold(0.0, f64::max),
            bounds: [V3::zeros(); 2],
            vertices,
            faces: Vec::new(),
            edges: Vec::new(),
            corners: Vec::new(),
        };
        hull.bounds = hull.bounds(&nalgebra::Matrix3::identity());
        let mut sides: BTreeMap<(u16, u16), usize> = BTreeMap::new();
        for (index, corners) in loops.iter().enumerate() {
            let start = hull.corners.len();
            hull.corners.extend(corners);
            let at = |k: usize| hull.vertices[usize::from(corners[k % corners.len()])];
            let area: V3 = (0..corners.len()).map(|k| (at(k) - at(0)).cross(&(at(k + 1) - at(0)))).sum();
            let normal = area.try_normalize(0.0)?;
            let offset = (0..corners.len()).map(|k| normal.dot(&at(k))).sum::<f64>() / corners.len() as f64;
            hull.faces.push(Face { normal, offset, corners: start..hull.corners.len() });
            for k in 0..corners.len() {
                let side = (corners[k], corners[(k + 1) % corners.len()]);
                if sides.insert(side, index).is_some() {
                    return None;
                }
            }
        }
        for (&(from, to), &face) in &sides {
            let other = *sides.get(&(to, from))?;
            if from < to {
                hull.edges.push(Edge { vertices: [from.into(), to.into()], faces: [face, other] });
            }
        }
        hull.inside = hull.vertices.iter().sum::<V3>() / hull.vertices.len() as f64;
        Some(hull)
    }

    fn is_convex(&self, tolerance: f64) -> bool {
        let below = |face: &Face| self.vertices.iter().all(|v| face.normal.dot(v) - face.offset <= tolerance);
        self.vertices.len() + self.faces.len() == self.edges.len() + 2 && self.faces.iter().all(below)
    }

    fn depth(&self, face: &Face) -> f64 {
        face.offset - self.support(&-face.normal).dot(&face.normal)
    }
}

/// Joins triangles of one plane and goes around each face.
fn face_loops(vertices: &[V3], triangles: &[[u32; 3]], flatness: f64) -> Option<Vec<Vec<u16>>> {
    let area = |triangle: &[u32; 3]| {
        let [a, b, c] = triangle.map(|vertex| vertices[vertex as usize]);
        (b - a).cross(&(c - a))
    };
    // Large triangles first: their planes are the most certain.
    let mut rest: Vec<[u32; 3]> = triangles.to_vec();
    rest.sort_by(|a, b| area(b).norm_squared().total_cmp(&area(a).norm_squared()));
    let mut loops = Vec::new();
    while let Some(first) = rest.first() {
        let (normal, origin) = (area(first).try_normalize(0.0)?, vertices[first[0] as usize]);
        let lies_in = |triangle: &[u32; 3]| {
            let near = |vertex: &u32| normal.dot(&(vertices[*vertex as usize] - origin)).abs() <= flatness;
            triangle.iter().all(near) && normal.dot(&area(triangle)) >= 0.0
        };
        let (face, others): (Vec<_>, Vec<_>) = rest.iter().partition(|triangle| lies_in(triangle));
        rest = others;
        let mut next: BTreeMap<u32, u32> = BTreeMap::new();
        let sides = || face.iter().flat_map(|&[a, b, c]| [(a, b), (b, c), (c, a)]);
        for (from, to) in sides().filter(|&(from, to)| !sides().any(|side| side == (to, from))) {
            next.insert(from, to);
        }
        let (&start, _) = next.first_key_value()?;
        let mut corners = vec![start as u16];
        let mut at = *next.get(&start)?;
        while at != start && corners.len() <= next.len() {
            corners.push(at as u16);
            at = *next.get(&at)?;
        }
        if corners.len() != next.len() || corners.len() < 3 {
            return None;
        }
        loops.push(corners);
    }
    Some(loops)
}
