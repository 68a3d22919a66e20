//! Convex polyhedra.

mod build;

use nalgebra::Matrix3;

use crate::solid::Solid;
use crate::spatial::V3;

pub use build::MAX_VERTICES;

/// A convex polyhedron with its faces and edges.
#[derive(Debug, Clone, PartialEq)]
pub struct Hull {
    vertices: Vec<V3>,
    faces: Vec<Face>,
    edges: Vec<Edge>,
    /// The corners of all faces.
    corners: Vec<u16>,
    inside: V3,
    /// Distance of the farthest corner from the origin, m, and the box around the corners.
    radius: f64,
    bounds: [V3; 2],
}

/// A face: the plane `normal . p = offset` and the corners, counter-clockwise seen from outside.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Face {
    pub normal: V3,
    pub offset: f64,
    corners: std::ops::Range<usize>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Edge {
    pub vertices: [usize; 2],
    pub faces: [usize; 2],
}

impl Hull {
    /// The corners, m.
    pub fn vertices(&self) -> &[V3] {
        &self.vertices
    }

    /// The triangles of its surface, each as three indices of vertices, counter-clockwise seen from outside.
    pub fn triangles(&self) -> impl Iterator<Item = [usize; 3]> + '_ {
        self.faces.iter().flat_map(|face| {
            let corners = self.corners(face);
            corners[1..].windows(2).map(|pair| [corners[0], pair[0], pair[1]].map(usize::from))
        })
    }

    pub(crate) fn faces(&self) -> &[Face] {
        &self.faces
    }

    pub(crate) fn edges(&self) -> &[Edge] {
        &self.edges
    }

    pub(crate) fn corners(&self, face: &Face) -> &[u16] {
        &self.corners[face.corners.clone()]
    }

    pub(crate) fn inside(&self) -> &V3 {
        &self.inside
    }

    /// Distance of its farthest corner from its origin, m.
    pub(crate) fn radius(&self) -> f64 {
        self.radius
    }

    /// The box around it in its own frame: least and greatest coordinates, m.
    pub(crate) fn own_bounds(&self) -> &[V3; 2] {
        &self.bounds
    }

    /// The vertex that is farthest along a vector.
    pub(crate) fn support(&self, direction: &V3) -> &V3 {
        let mut best = &self.vertices[0];
        let mut most = best.dot(direction);
        for vertex in &self.vertices[1..] {
            let along = vertex.dot(direction);
            if along > most {
                (best, most) = (vertex, along);
            }
        }
        best
    }

    pub(crate) fn bounds(&self, frame_from_shape: &Matrix3<f64>) -> [V3; 2] {
        let first = frame_from_shape * self.vertices[0];
        self.vertices[1..].iter().fold([first, first], |[low, high], vertex| {
            let point = frame_from_shape * vertex;
            [low.inf(&point), high.sup(&point)]
        })
    }

    /// Signed distance of a point to the surface, m, and the outward direction of its fastest growth.
    pub(crate) fn distance(&self, p: &V3) -> (f64, V3) {
        let mut outermost = (f64::NEG_INFINITY, V3::zeros());
        let mut nearest: Option<(f64, V3)> = None;
        for face in &self.faces {
            let distance = face.normal.dot(p) - face.offset;
            if distance > outermost.0 {
                outermost = (distance, face.normal);
            }
            if distance > 0.0 && nearest.is_none_or(|(least, _)| distance * distance < least) {
                let between = p - self.nearest_on_face(face, p, distance);
                let square = between.norm_squared();
                if nearest.is_none_or(|(least, _)| square < least) {
                    nearest = Some((square, between));
                }
            }
        }
        match nearest {
            // A point on the surface takes the normal of its face.
            Some((square, between)) if square > 1e-24 => {
                let distance = libm::sqrt(square);
                (distance, between / distance)
            }
            _ => outermost,
        }
    }

    /// The point of a face nearest to a point at a height above its plane.
    fn nearest_on_face(&self, face: &Face, p: &V3, height: f64) -> V3 {
        let foot = p - face.normal * height;
        let corners = self.corners(face);
        let mut nearest: Option<(f64, V3)> = None;
        for (k, &corner) in corners.iter().enumerate() {
            let (a, b) =
                (self.vertices[usize::from(corner)], self.vertices[usize::from(corners[(k + 1) % corners.len()])]);
            let along = b - a;
            if face.normal.cross(&along).dot(&(foot - a)) < 0.0 {
                let t = ((foot - a).dot(&along) / along.norm_squared()).clamp(0.0, 1.0);
                let on_edge = a + along * t;
                let square = (foot - on_edge).norm_squared();
                if nearest.is_none_or(|(least, _)| square < least) {
                    nearest = Some((square, on_edge));
                }
            }
        }
        nearest.map_or(foot, |(_, point)| point)
    }

    /// Where a ray has entered all half-spaces of the faces, unless it has left one by then.
    pub(crate) fn cast_ray(&self, origin: &V3, direction: &V3) -> Option<f64> {
        let (mut enter, mut leave) = (0.0_f64, f64::INFINITY);
        for face in &self.faces {
            let (above, rate) = (face.normal.dot(origin) - face.offset, face.normal.dot(direction));
            if rate < 0.0 {
                enter = enter.max(-above / rate);
            } else if rate > 0.0 {
                leave = leave.min(-above / rate);
            } else if above > 0.0 {
                return None;
            }
        }
        (enter <= leave).then_some(enter)
    }

    /// Sums over tetrahedra from an inner point.
    pub(crate) fn solid(&self) -> Solid {
        let (mut volume, mut first, mut second) = (0.0, V3::zeros(), Matrix3::zeros());
        for triangle in self.triangles() {
            let [a, b, c] = triangle.map(|vertex| self.vertices[vertex] - self.inside);
            let part = a.dot(&b.cross(&c)) / 6.0;
            let sum = a + b + c;
            volume += part;
            first += sum * (part / 4.0);
            let squares = a * a.transpose() + b * b.transpose() + c * c.transpose() + sum * sum.transpose();
            second += squares * (part / 20.0);
        }
        let center = first / volume;
        let about_center = second - center * center.transpose() * volume;
        let inertia = Matrix3::from_diagonal_element(about_center.trace()) - about_center;
        Solid { volume, center: self.inside + center, inertia }
    }
}
