//! Contact points of hulls with hulls and half-spaces: the separating axis of least overlap among the faces and the pairs of
//! edges, then one face clipped by the other, or the point where two edges cross. A pure function of the two poses.

use parry3d_f64::math::Vector;
use parry3d_f64::shape::SupportMap;

use super::closed_form::{Placed, Point};
use super::nearest::{nearest, pose_between, vector};
use crate::hull::{Edge, Hull, MAX_VERTICES};
use crate::spatial::V3;

/// Two edges decide only if their axis separates by this much more than every face's, m: the points of a face hold steadier.
const FACE_BIAS: f64 = 1e-5;
/// Edges with a smaller sine of the angle between them have no axis of their own.
const PARALLEL_SINE: f64 = 1e-3;
/// Most contact points of a pair.
const MAX_POINTS: usize = 8;

/// Memory for one pair at a time.
#[derive(Clone, Default)]
pub(super) struct HullScratch {
    /// The second hull in the frame of the first.
    vertices: Vec<V3>,
    normals: Vec<V3>,
    offsets: Vec<f64>,
    /// Edges of the second hull that come near the first.
    near_edges: Vec<Edge>,
    polygon: Vec<V3>,
    clipped: Vec<V3>,
    /// Points half-way between the surfaces, and their gaps.
    points: Vec<(V3, f64)>,
}

impl HullScratch {
    /// Memory for the largest hulls, so that no step has to grow it.
    pub fn new() -> Self {
        let room = 2 * MAX_VERTICES;
        Self {
            vertices: Vec::with_capacity(MAX_VERTICES),
            normals: Vec::with_capacity(room),
            offsets: Vec::with_capacity(room),
            near_edges: Vec::with_capacity(3 * MAX_VERTICES),
            polygon: Vec::with_capacity(room),
            clipped: Vec::with_capacity(room),
            points: Vec::with_capacity(room),
        }
    }
}

impl SupportMap for Hull {
    fn local_support_point(&self, direction: Vector) -> Vector {
        vector(self.support(&V3::new(direction.x, direction.y, direction.z)))
    }
}

/// A half-space (first) and a hull: the vertices within the margin.
pub(super) fn half_space_hull(
    scratch: &mut HullScratch,
    plane: &Placed,
    (placed, hull): (&Placed, &Hull),
    margin: f64,
    out: &mut impl FnMut(Point),
) {
    let normal = plane.rotation.column(2).into_owned();
    let local_normal = placed.rotation.tr_mul(&normal);
    let height = (placed.position - plane.position).dot(&normal);
    scratch.points.clear();
    for vertex in hull.vertices() {
        let distance = height + local_normal.dot(vertex);
        if distance <= margin {
            scratch.points.push((vertex - local_normal * (0.5 * distance), distance));
        }
    }
    emit(&mut scratch.points, placed, &local_normal, normal, out);
}

/// Writes points that are in a shape's frame.
fn emit(points: &mut Vec<(V3, f64)>, placed: &Placed, local_normal: &V3, normal: V3, out: &mut impl FnMut(Point)) {
    reduce(points, local_normal);
    for (point, distance) in points {
        out(Point { position: placed.position + placed.rotation * *point, normal, distance: *distance });
    }
}

/// Leaves the deepest point and those that are outermost along seven directions across the normal.
fn reduce(points: &mut Vec<(V3, f64)>, normal: &V3) {
    if points.len() <= MAX_POINTS {
        return;
    }
    let mut x = V3::zeros();
    x[normal.iamin()] = 1.0;
    let x = normal.cross(&x).normalize();
    let y = normal.cross(&x);
    let deepest = (0..points.len()).min_by(|&i, &j| points[i].1.total_cmp(&points[j].1)).unwrap_or(0);
    points.swap(0, deepest);
    for k in 1..MAX_POINTS {
        let angle = std::f64::consts::TAU * k as f64 / (MAX_POINTS - 1) as f64;
        let along = x * libm::cos(angle) + y * libm::sin(angle);
        let reach = |&i: &usize| points[i].0.dot(&along);
        // A point that is outermost twice makes way for the next one.
        let outermost = (k..points.len()).max_by(|i, j| reach(i).total_cmp(&reach(j))).unwrap_or(k);
        points.swap(k, outermost);
    }
    points.truncate(MAX_POINTS);
}

/// The axis along which two hulls overlap least, or are farthest apart.
#[derive(Clone, Copy)]
enum Axis {
    FaceA(usize),
    FaceB(usize),
    Edges { normal: V3, a: Edge, b: Edge },
}

pub(super) fn hull_hull(
    scratch: &mut HullScratch,
    (place_a, a): (&Placed, &Hull),
    (place_b, b): (&Placed, &Hull),
    margin: f64,
    out: &mut impl FnMut(Point),
) {
    let rotation = place_a.rotation.tr_mul(&place_b.rotation);
    let translation = place_a.rotation.tr_mul(&(place_b.position - place_a.position));
    scratch.vertices.clear();
    scratch.vertices.extend(b.vertices().iter().map(|vertex| rotation * vertex + translation));
    scratch.normals.clear();
    scratch.normals.extend(b.faces().iter().map(|face| rotation * face.normal));
    scratch.offsets.clear();
    let normals = scratch.normals.iter().zip(b.faces());
    scratch.offsets.extend(normals.map(|(normal, face)| face.offset + normal.dot(&translation)));
    let Some((axis, separation)) = best_axis(scratch, a, b, margin) else { return };
    let normal = match axis {
        Axis::FaceA(face) => {
            clip_b_by_a(scratch, a, b, face, margin);
            a.faces()[face].normal
        }
        Axis::FaceB(face) => {
            clip_a_by_b(scratch, a, b, face, margin);
            -scratch.normals[face]
        }
        Axis::Edges { normal, a: edge_a, b: edge_b } => {
            let [a0, a1] = edge_a.vertices.map(|v| a.vertices()[v]);
            let [b0, b1] = edge_b.vertices.map(|v| scratch.vertices[v]);
            scratch.points.clear();
            scratch.points.push((middle_of_edges([a0, a1], [b0, b1]), separation));
            normal
        }
    };
    emit(&mut scratch.points, place_a, &normal, place_a.rotation * normal, out);
    if scratch.points.iter().all(|(_, distance)| *distance > 0.0) && separation > 0.0 {
        nearest(place_a, &pose_between(place_a, place_b), a, b, margin, out);
    }
}

/// None if the hulls are farther apart than the margin.
fn best_axis(scratch: &mut HullScratch, a: &Hull, b: &Hull, margin: f64) -> Option<(Axis, f64)> {
    let least =
        |vertices: &[V3], normal: &V3| vertices.iter().map(|vertex| normal.dot(vertex)).fold(f64::INFINITY, f64::min);
    let (mut best, mut most) = (Axis::FaceA(0), f64::NEG_INFINITY);
    for (index, face) in a.faces().iter().enumerate() {
        let separation = least(&scratch.vertices, &face.normal) - face.offset;
        if separation > most {
            (best, most) = (Axis::FaceA(index), separation);
        }
    }
    for (index, (normal, offset)) in scratch.normals.iter().zip(&scratch.offsets).enumerate() {
        let separation = least(a.vertices(), normal) - offset;
        if separation > most {
            (best, most) = (Axis::FaceB(index), separation);
        }
    }
    if most > margin {
        return None;
    }
    // Edges that decide lie within the depth, or the margin, of the other hull.
    let reach = margin.max(-most);
    let box_of = |points: &[V3]| {
        let (low, high) = points.iter().fold((points[0], points[0]), |(low, high), p| (low.inf(p), high.sup(p)));
        (low.add_scalar(-reach), high.add_scalar(reach))
    };
    let (box_a, box_b) = (box_of(a.vertices()), box_of(&scratch.vertices));
    let meets =
        |[p, q]: [V3; 2], (low, high): &(V3, V3)| (0..3).all(|k| p[k].min(q[k]) <= high[k] && p[k].max(q[k]) >= low[k]);
    scratch.near_edges.clear();
    let vertices = &scratch.vertices;
    scratch.near_edges.extend(b.edges().iter().filter(|edge| meets(edge.vertices.map(|v| vertices[v]), &box_a)));
    let mut to_beat = most + FACE_BIAS;
    for edge_a in a.edges() {
        let [a0, a1] = edge_a.vertices.map(|v| a.vertices()[v]);
        if !meets([a0, a1], &box_b) {
            continue;
        }
        let (along_a, normals_a) = (a1 - a0, edge_a.faces.map(|face| a.faces()[face].normal));
        for edge_b in &scratch.near_edges {
            let [b0, b1] = edge_b.vertices.map(|v| scratch.vertices[v]);
            let along_b = b1 - b0;
            if !arcs_cross(normals_a, along_a, edge_b.faces.map(|face| -scratch.normals[face]), along_b) {
                continue;
            }
            let axis = along_a.cross(&along_b);
            let length = axis.norm();
            if length <= PARALLEL_SINE * along_a.norm() * along_b.norm() {
                continue;
            }
            let outwards = if axis.dot(&(a0 - a.inside())) < 0.0 { -1.0 } else { 1.0 };
            let normal = axis * (outwards / length);
            let separation = normal.dot(&(b0 - a0));
            if separation > to_beat {
                (best, most, to_beat) = (Axis::Edges { normal, a: *edge_a, b: *edge_b }, separation, separation);
            }
        }
    }
    (most <= margin).then_some((best, most))
}

/// True if the arcs between the normals beside two edges cross on the sphere of directions: then the edges' common normal
/// supports both hulls there. The normals of the second edge are reversed.
fn arcs_cross([a, b]: [V3; 2], along_a: V3, [c, d]: [V3; 2], along_b: V3) -> bool {
    // Up to a factor of one sign each, these are the normals of the great circles through the arcs.
    let (circle_a, circle_b) = (orient(along_a, &a, &b), orient(along_b, &c, &d));
    let (c_side, d_side) = (c.dot(&circle_a), d.dot(&circle_a));
    let (a_side, b_side) = (a.dot(&circle_b), b.dot(&circle_b));
    c_side * d_side < 0.0 && a_side * b_side < 0.0 && c_side * b_side > 0.0
}

/// The edge's direction, along `b x a`.
fn orient(along: V3, a: &V3, b: &V3) -> V3 {
    if b.cross(a).dot(&along) < 0.0 { -along } else { along }
}

/// Half-way between the nearest points of the lines through two edges that are not parallel, kept on the edges.
fn middle_of_edges([a0, a1]: [V3; 2], [b0, b1]: [V3; 2]) -> V3 {
    let (u, v, w) = (a1 - a0, b1 - b0, a0 - b0);
    let (uu, uv, vv, uw, vw) = (u.dot(&u), u.dot(&v), v.dot(&v), u.dot(&w), v.dot(&w));
    let determinant = uu * vv - uv * uv;
    let s = ((uv * vw - vv * uw) / determinant).clamp(0.0, 1.0);
    let t = ((uu * vw - uv * uw) / determinant).clamp(0.0, 1.0);
    (a0 + u * s + b0 + v * t) * 0.5
}

/// Clips the face of `b` that lies deepest below a face of `a`.
fn clip_b_by_a(scratch: &mut HullScratch, a: &Hull, b: &Hull, face: usize, margin: f64) {
    let HullScratch { vertices, normals, polygon, clipped, points, .. } = scratch;
    let reference = &a.faces()[face];
    let incident = incident_face(b, vertices, normals.iter().copied(), &reference.normal);
    polygon.clear();
    polygon.extend(b.corners(&b.faces()[incident]).iter().map(|&corner| vertices[usize::from(corner)]));
    let corners = a.corners(reference).iter().map(|&corner| a.vertices()[usize::from(corner)]);
    clip(polygon, clipped, corners, &reference.normal);
    gather(points, polygon, &reference.normal, reference.offset, margin);
}

/// The same with the parts of the hulls exchanged.
fn clip_a_by_b(scratch: &mut HullScratch, a: &Hull, b: &Hull, face: usize, margin: f64) {
    let HullScratch { vertices, normals, offsets, polygon, clipped, points, .. } = scratch;
    let normal = normals[face];
    let incident = incident_face(a, a.vertices(), a.faces().iter().map(|face| face.normal), &normal);
    polygon.clear();
    polygon.extend(a.corners(&a.faces()[incident]).iter().map(|&corner| a.vertices()[usize::from(corner)]));
    let corners = b.corners(&b.faces()[face]).iter().map(|&corner| vertices[usize::from(corner)]);
    clip(polygon, clipped, corners, &normal);
    gather(points, polygon, &normal, offsets[face], margin);
}

/// Of the faces at the deepest vertex the one that looks most against a normal.
fn incident_face(hull: &Hull, vertices: &[V3], normals: impl Iterator<Item = V3>, normal: &V3) -> usize {
    let depth = |vertex: usize| vertices[vertex].dot(normal);
    let deepest = (0..vertices.len()).min_by(|&i, &j| depth(i).total_cmp(&depth(j))).unwrap_or(0);
    let at_deepest = |face: &usize| hull.corners(&hull.faces()[*face]).contains(&(deepest as u16));
    let along = normals.map(|other| other.dot(normal)).enumerate().filter(|(face, _)| at_deepest(face));
    along.min_by(|(_, x), (_, y)| x.total_cmp(y)).map_or(0, |(face, _)| face)
}

/// Cuts off what of a polygon lies outside of the sides of a face.
fn clip(polygon: &mut Vec<V3>, clipped: &mut Vec<V3>, corners: impl ExactSizeIterator<Item = V3> + Clone, normal: &V3) {
    let next = corners.clone().cycle().skip(1);
    for (from, to) in corners.zip(next) {
        let outwards = (to - from).cross(normal);
        let outside = |p: &V3| outwards.dot(&(p - from));
        clipped.clear();
        for (k, q) in polygon.iter().enumerate() {
            let p = &polygon[if k == 0 { polygon.len() } else { k } - 1];
            let (before, now) = (outside(p), outside(q));
            if (before > 0.0) != (now > 0.0) {
                clipped.push(p + (q - p) * (before / (before - now)));
            }
            if now <= 0.0 {
                clipped.push(*q);
            }
        }
        std::mem::swap(polygon, clipped);
    }
}

/// Points of the polygon within the margin of a face's plane, half-way to it.
fn gather(points: &mut Vec<(V3, f64)>, polygon: &[V3], normal: &V3, offset: f64, margin: f64) {
    points.clear();
    let gaps = polygon.iter().map(|p| (p, normal.dot(p) - offset)).filter(|(_, gap)| *gap <= margin);
    points.extend(gaps.map(|(p, gap)| (p - normal * (0.5 * gap), gap)));
}
