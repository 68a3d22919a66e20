//! Signed distances and nearest points between shapes, for planners. Balls and capsules are points and segments with a radius
//! around them, so that parry's general convex query only meets polytopes, on which it is exact.

use nalgebra::Isometry3;
use parry3d_f64::math::{Pose, Rotation, Vector};
use parry3d_f64::query::details::{
    contact_support_map_support_map, intersection_test_support_map_support_map as intersect,
};
use parry3d_f64::shape::{Cuboid, Segment, SupportMap};

use crate::geometry::Geometry;
use crate::hull::Hull;
use crate::mechanics::Mechanics;
use crate::model::Model;
use crate::spatial::V3;
use crate::spec::ShapeId;

/// Where two shapes are nearest to each other; where they overlap, how to part them by the shortest way.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Nearest {
    /// Gap, m; negative when the shapes overlap.
    pub distance: f64,
    /// The nearest point of each surface, world, m.
    pub points: [V3; 2],
    /// Unit vector from the first shape to the second, world: the distance grows fastest when the second moves along it.
    pub normal: V3,
}

/// A bound of a gap may be off by rounding by far less than this, m.
const SLACK: f64 = 1e-6;

/// A shape without its radius.
enum Core<'a> {
    Segment(Segment),
    Cuboid(Cuboid),
    Hull(Corners<'a>),
}

/// The corners of a hull, as parry asks for them.
struct Corners<'a>(&'a Hull);

impl SupportMap for Corners<'_> {
    fn local_support_point(&self, direction: Vector) -> Vector {
        let corner = self.0.support(&V3::new(direction.x, direction.y, direction.z));
        Vector::new(corner.x, corner.y, corner.z)
    }
}

impl<'a> Core<'a> {
    /// The core and the radius around it; none for a half-space.
    fn of(geometry: &'a Geometry) -> Option<(Self, f64)> {
        let segment =
            |half: f64| Core::Segment(Segment::new(Vector::new(0.0, 0.0, -half), Vector::new(0.0, 0.0, half)));
        match geometry {
            Geometry::HalfSpace => None,
            Geometry::Sphere { radius } => Some((segment(0.0), *radius)),
            Geometry::Capsule { radius, half_length } => Some((segment(*half_length), *radius)),
            Geometry::Cuboid { half_extents: h } => Some((Core::Cuboid(Cuboid::new(Vector::new(h.x, h.y, h.z))), 0.0)),
            Geometry::Hull(hull) => Some((Core::Hull(Corners(hull)), 0.0)),
        }
    }

    fn map(&self) -> &dyn SupportMap {
        match self {
            Core::Segment(segment) => segment,
            Core::Cuboid(cuboid) => cuboid,
            Core::Hull(corners) => corners,
        }
    }

    /// At most the distance of a point to it, both in its frame, m.
    fn outside(&self, point: &V3) -> f64 {
        let [low, high] = match self {
            Core::Segment(segment) => [segment.a, segment.b].map(|end| V3::new(end.x, end.y, end.z)),
            Core::Cuboid(cuboid) => {
                let half = V3::new(cuboid.half_extents.x, cuboid.half_extents.y, cuboid.half_extents.z);
                [-half, half]
            }
            Core::Hull(Corners(hull)) => *hull.own_bounds(),
        };
        (point - point.sup(&low).inf(&high)).norm()
    }

    /// The point that is farthest in a direction, both in the world.
    fn support(&self, world_from_core: &Isometry3<f64>, direction: &V3) -> V3 {
        let local = world_from_core.inverse_transform_vector(direction);
        let point = self.map().local_support_point(Vector::new(local.x, local.y, local.z));
        (world_from_core * nalgebra::Point3::new(point.x, point.y, point.z)).coords
    }
}

impl Mechanics {
    /// Pose of a shape.
    ///
    /// # Panics
    /// If the model has no such shape.
    pub fn world_from_shape(&self, model: &Model, shape: ShapeId) -> Isometry3<f64> {
        let spec = &model.shapes[shape.0];
        self.world_from_body(spec.body) * spec.body_from_shape
    }

    /// Signed distance and nearest points of two shapes, of one tree or not; none if the gap is wider than `most`, m, which may
    /// be infinite; of polytopes that overlap by more than a `most` below 0 it may find none. Two shapes that may never touch
    /// have a distance, too. Allocates only where boxes overlap.
    ///
    /// # Panics
    /// If the model has no such shape.
    pub fn nearest(&self, model: &Model, a: ShapeId, b: ShapeId, most: f64) -> Option<Nearest> {
        self.nearest_of(model, [a, b], [a, b].map(|shape| self.ball(model, shape)), most)
    }

    /// The ball about a shape: its middle, and its radius, m, which is infinite for a half-space.
    fn ball(&self, model: &Model, shape: ShapeId) -> (V3, f64) {
        let spec = &model.shapes[shape.0];
        let center = self.world_point(spec.body, &spec.body_from_shape.translation.vector);
        let is_plane = matches!(spec.geometry, Geometry::HalfSpace);
        (center, if is_plane { f64::INFINITY } else { spec.geometry.radius() })
    }

    /// As [`Mechanics::nearest`], of shapes in these balls.
    fn nearest_of(&self, model: &Model, shapes: [ShapeId; 2], balls: [(V3, f64); 2], most: f64) -> Option<Nearest> {
        let [(center_a, extent_a), (center_b, extent_b)] = balls;
        let gap = (center_b - center_a).norm() - extent_a - extent_b;
        // A gap that is not a number is none.
        if gap.is_nan() || gap > most {
            return None;
        }
        let poses = shapes.map(|shape| self.world_from_shape(model, shape));
        match shapes.map(|shape| Core::of(&model.shapes[shape.0].geometry)) {
            [None, None] => None,
            [None, Some(core)] => above_plane(&poses[0], &core, &poses[1], most),
            [Some(core), None] => above_plane(&poses[1], &core, &poses[0], most).map(Nearest::reversed),
            [Some(core_a), Some(core_b)] => {
                // A long shape is far from most of the ball around it. How deep shapes overlap is not known so.
                let (larger, core, smaller, extent) = if extent_b > extent_a {
                    (&poses[1], &core_b, center_a, extent_a)
                } else {
                    (&poses[0], &core_a, center_b, extent_b)
                };
                let gap = core.0.outside(&larger.inverse_transform_point(&smaller.into()).coords) - core.1 - extent;
                if gap > most.max(0.0) + SLACK { None } else { between(poses, core_a, core_b, most) }
            }
        }
    }

    /// Gaps between shapes in the present state; for many pairs at once.
    pub fn gaps<'a>(&'a mut self, model: &'a Model) -> Gaps<'a> {
        let mut balls = std::mem::take(&mut self.balls);
        balls.clear();
        balls.extend((0..model.shapes.len()).map(|shape| self.ball(model, ShapeId(shape))));
        self.balls = balls;
        Gaps { mechanics: self, model }
    }
}

/// Gaps between the shapes of a state: [`Mechanics::gaps`].
#[derive(Debug, Clone, Copy)]
pub struct Gaps<'a> {
    mechanics: &'a Mechanics,
    model: &'a Model,
}

impl Gaps<'_> {
    /// As [`Mechanics::nearest`].
    ///
    /// # Panics
    /// If the model has no such shape.
    pub fn nearest(&self, a: ShapeId, b: ShapeId, most: f64) -> Option<Nearest> {
        self.mechanics.nearest_of(self.model, [a, b], [a, b].map(|shape| self.mechanics.balls[shape.0]), most)
    }

    /// True if the gap of one of some pairs of shapes is at most so wide, m; below 0, if they overlap by so much.
    ///
    /// # Panics
    /// If the model does not have one of the shapes.
    pub fn any_within(&self, pairs: &[(ShapeId, ShapeId)], most: f64) -> bool {
        if most < 0.0 {
            // Deep overlaps are found only among those that are looked for from 0 on.
            return self.nearest_pair(pairs, 0.0).is_some_and(|(_, nearest)| nearest.distance <= most);
        }
        pairs.iter().any(|&(a, b)| self.nearest(a, b, most).is_some_and(|nearest| nearest.distance <= most))
    }

    /// The nearest two of some pairs of shapes, by their place in the list; none if all gaps are wider than `most`, m.
    ///
    /// # Panics
    /// If the model does not have one of the shapes.
    pub fn nearest_pair(&self, pairs: &[(ShapeId, ShapeId)], most: f64) -> Option<(usize, Nearest)> {
        let mut best: Option<(usize, Nearest)> = None;
        for (index, &(a, b)) in pairs.iter().enumerate() {
            let most = best.map_or(most, |(_, nearest)| nearest.distance);
            if let Some(nearest) = self.nearest(a, b, most).filter(|nearest| nearest.distance <= most) {
                best = Some((index, nearest));
            }
        }
        best
    }
}

impl Nearest {
    fn reversed(self) -> Self {
        let [a, b] = self.points;
        Self { distance: self.distance, points: [b, a], normal: -self.normal }
    }

    /// From the nearest points of two cores.
    fn around(points: [V3; 2], normal: V3, distance: f64, radii: [f64; 2]) -> Self {
        let points = [points[0] + normal * radii[0], points[1] - normal * radii[1]];
        Self { distance: distance - radii[0] - radii[1], points, normal }
    }
}

fn above_plane(
    plane: &Isometry3<f64>,
    (core, radius): &(Core<'_>, f64),
    other: &Isometry3<f64>,
    most: f64,
) -> Option<Nearest> {
    let normal = plane.rotation * V3::z();
    let lowest = core.support(other, &-normal);
    let height = (lowest - plane.translation.vector).dot(&normal);
    let nearest = Nearest::around([lowest - normal * height, lowest], normal, height, [0.0, *radius]);
    (nearest.distance <= most).then_some(nearest)
}

fn between(
    [a, b]: [Isometry3<f64>; 2],
    (core_a, radius_a): (Core<'_>, f64),
    (core_b, radius_b): (Core<'_>, f64),
    most: f64,
) -> Option<Nearest> {
    let a_from_b = a.inv_mul(&b);
    let (t, q) = (a_from_b.translation.vector, a_from_b.rotation);
    let pose = Pose { rotation: Rotation::from_xyzw(q.i, q.j, q.k, q.w), translation: Vector::new(t.x, t.y, t.z) };
    let radii = [radius_a, radius_b];
    let most = most + radius_a + radius_b;
    let vector = |v: Vector| V3::new(v.x, v.y, v.z);
    if let Some(found) = contact_support_map_support_map(&pose, core_a.map(), core_b.map(), most) {
        let world = |iso: &Isometry3<f64>, point: Vector| (iso * nalgebra::Point3::from(vector(point))).coords;
        let points = [world(&a, found.point1), world(&b, found.point2)];
        return Some(Nearest::around(points, a.rotation * vector(found.normal1), found.dist, radii));
    }
    if !intersect(&pose, core_a.map(), core_b.map()) {
        return None;
    }
    // Cores that just meet, as two crossing segments do, have no normal of their own.
    let normal = (b.translation.vector - a.translation.vector).try_normalize(1e-12).unwrap_or_else(V3::z);
    let meets = core_b.support(&b, &-normal);
    Some(Nearest::around([meets; 2], normal, 0.0, radii))
}
