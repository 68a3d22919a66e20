//! Contact points of a configuration. A pure function of poses and velocities: nothing survives a step, so a world can be
//! restarted from one recorded row.

mod closed_form;
mod nearest;
mod polyhedra;

use std::sync::Arc;

use nalgebra::Matrix3;
use parry3d_f64::math::Vector;
use parry3d_f64::query::ContactManifold;
use parry3d_f64::query::details::contact_manifold_cuboid_cuboid;
use parry3d_f64::shape::Cuboid;

use crate::contact::Contact;
use crate::error::{ModelError, check_array};
use crate::geometry::Geometry;
use crate::hull::Hull;
use crate::kinematics::Kinematics;
use crate::model::{CullGroupPair, Model, State};
use crate::spatial::V3;
use crate::spec::{Material, ShapeId};
use closed_form::{BoxAt, Placed, Point, box_distance};
use nearest::{nearest, pose_between, vector};
use polyhedra::HullScratch;

/// Shapes nearer than this are contact candidates even at rest, m.
const REST_MARGIN: f64 = 2e-3;
/// Most that speed may add to a pair's margin, m.
const MAX_SPEED_MARGIN: f64 = 0.1;

#[derive(Debug, Clone, Copy)]
struct Aabb {
    min: V3,
    max: V3,
}

impl Aabb {
    const EMPTY: Aabb = Aabb { min: V3::new(1e30, 1e30, 1e30), max: V3::new(-1e30, -1e30, -1e30) };

    #[inline(always)]
    fn inflated(&self, margin: f64) -> Aabb {
        Aabb { min: self.min.add_scalar(-margin), max: self.max.add_scalar(margin) }
    }

    #[inline(always)]
    fn overlaps(&self, other: &Aabb) -> bool {
        // Six comparisons cost less than a branch that is hard to foresee.
        let below = |a: &V3, b: &V3| (a.x <= b.x) & (a.y <= b.y) & (a.z <= b.z);
        below(&self.min, &other.max) & below(&other.min, &self.max)
    }
}

/// Bounds of shapes and of their cull groups, inflated by what may be travelled in a step.
#[derive(Debug, Clone)]
struct Bounds {
    shapes: Vec<Aabb>,
    cull_groups: Vec<Aabb>,
}

#[derive(Clone)]
pub(crate) struct Collider {
    placed: Vec<Placed>,
    /// For pairs of different trees: inflated by the shapes' own speed.
    bounds: Bounds,
    /// For pairs of one tree: inflated by the speed relative to the root, so that a falling body stays small to itself.
    kin_bounds: Bounds,
    travel: Vec<Travel>,
    scratch: Scratch,
    carriers: Vec<Carrier>,
    moving: Vec<Moving>,
}

/// Scratch memory for contacts of single pairs.
#[derive(Clone)]
struct Scratch {
    manifold: ContactManifold<(), ()>,
    /// The hull of each shape that has one. Boxes have one only in a model with hulls, to meet them.
    hulls: Vec<Option<Arc<Hull>>>,
    hull: HullScratch,
}

impl Scratch {
    fn new(model: &Model) -> Self {
        let any = model.shapes.iter().any(|shape| matches!(shape.geometry, Geometry::Hull(_)));
        let hull_of = |geometry: &Geometry| match geometry {
            Geometry::Hull(hull) => Some(Arc::clone(hull)),
            Geometry::Cuboid { half_extents } if any => Hull::cuboid(half_extents).map(Arc::new),
            _ => None,
        };
        let mut manifold = ContactManifold::new();
        manifold.points.reserve(64);
        let hulls = model.shapes.iter().map(|shape| hull_of(&shape.geometry)).collect();
        Self { manifold, hulls, hull: if any { HullScratch::new() } else { HullScratch::default() } }
    }
}

/// Velocity of a shape's centre, and how much faster another of its points may be.
#[derive(Debug, Clone, Copy)]
struct Travel {
    velocity: V3,
    spin_speed: f64,
}

/// A body with shapes of one cull group.
#[derive(Debug, Clone)]
struct Carrier {
    body: usize,
    root: usize,
    cull_group: usize,
    /// The cull group takes part in pairs of one tree.
    in_tree: bool,
    /// The cull group has shapes of this body alone.
    is_alone: bool,
    /// Where the body was when its shapes were placed last, if it stood still; placing them again would change nothing.
    still_at: Option<(V3, Matrix3<f64>)>,
    /// Its shapes, in [`Collider::moving`].
    shapes: std::ops::Range<usize>,
}

/// Inputs of the update of a moving shape.
#[derive(Debug, Clone)]
struct Moving {
    shape: usize,
    geometry: Geometry,
    rotation: Matrix3<f64>,
    position: V3,
    /// Farthest point from the shape's own origin.
    extent: f64,
}

impl std::fmt::Debug for Collider {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Collider").field("shapes", &self.placed.len()).finish_non_exhaustive()
    }
}

impl Bounds {
    fn new(model: &Model) -> Self {
        Self { shapes: vec![Aabb::EMPTY; model.shapes.len()], cull_groups: vec![Aabb::EMPTY; model.cull_groups.len()] }
    }

    fn set(&mut self, shape: usize, cull_group: usize, bounds: Aabb) {
        self.shapes[shape] = bounds;
        grow(&mut self.cull_groups[cull_group], &bounds);
    }
}

impl Carrier {
    /// True if the body stands still where it stood still last.
    #[inline(always)]
    fn is_kept(&self, kin: &Kinematics) -> bool {
        let motion = &kin.motion[self.body];
        self.still_at.is_some_and(|(position, rotation)| {
            position == kin.position[self.body]
                && rotation == kin.rotation[self.body]
                && motion.linear == V3::zeros()
                && motion.angular == V3::zeros()
        })
    }

    fn note_still(&mut self, kin: &Kinematics) {
        let motion = &kin.motion[self.body];
        // Only shapes whose bounds no other body grows, and without a second set of bounds.
        if self.is_alone && !self.in_tree && motion.linear == V3::zeros() && motion.angular == V3::zeros() {
            self.still_at = Some((kin.position[self.body], kin.rotation[self.body]));
        }
    }
}

impl Collider {
    pub fn new(model: &Model) -> Self {
        let shapes = model.shapes.len();
        let mut collider = Self {
            placed: Vec::with_capacity(shapes),
            bounds: Bounds::new(model),
            kin_bounds: Bounds::new(model),
            travel: vec![Travel { velocity: V3::zeros(), spin_speed: 0.0 }; shapes],
            scratch: Scratch::new(model),
            carriers: Vec::new(),
            moving: Vec::new(),
        };
        for (index, shape) in model.shapes.iter().enumerate() {
            let rotation = *shape.body_from_shape.rotation.to_rotation_matrix().matrix();
            let position = shape.body_from_shape.translation.vector;
            collider.placed.push(Placed { rotation, position });
            let cull_group = model.cull_groups.iter().position(|c| c.contains(&index)).unwrap_or(0);
            if shape.body.0 == 0 {
                let bounds = bounds_of(&shape.geometry, &collider.placed[index], 0.5 * REST_MARGIN);
                collider.bounds.set(index, cull_group, bounds);
            } else {
                let (body, at) = (shape.body.0, collider.moving.len());
                match collider.carriers.last_mut() {
                    Some(last) if last.body == body && last.cull_group == cull_group => last.shapes.end += 1,
                    _ => {
                        let root = model.bodies[body].root.0;
                        let in_tree =
                            |pair: &CullGroupPair| pair.one_tree && (pair.a == cull_group || pair.b == cull_group);
                        let in_tree = model.pairs.iter().any(in_tree);
                        let is_alone = model.cull_groups[cull_group].iter().all(|&s| model.shapes[s].body.0 == body);
                        collider.carriers.push(Carrier {
                            body,
                            root,
                            cull_group,
                            in_tree,
                            is_alone,
                            still_at: None,
                            shapes: at..at + 1,
                        });
                    }
                }
                let (geometry, extent) = (shape.geometry.clone(), shape.geometry.radius());
                collider.moving.push(Moving { shape: index, geometry, rotation, position, extent });
            }
        }
        collider
    }

    /// Places all shapes. Their bounds cover what they may travel in `dt` s, up to 0.1 m, so that a body that is not faster
    /// than that meets a surface in the step in which it would pass it.
    pub fn update(&mut self, kin: &Kinematics, dt: f64) {
        for carrier in &mut self.carriers {
            if carrier.is_kept(kin) {
                continue;
            }
            carrier.still_at = None;
            self.bounds.cull_groups[carrier.cull_group] = Aabb::EMPTY;
            self.kin_bounds.cull_groups[carrier.cull_group] = Aabb::EMPTY;
        }
        let margin = |speed: f64| 0.5 * REST_MARGIN + (dt * speed).min(MAX_SPEED_MARGIN);
        for carrier in &mut self.carriers {
            if carrier.still_at.is_some() {
                continue;
            }
            carrier.note_still(kin);
            let (body, root, cull_group) = (carrier.body, carrier.root, carrier.cull_group);
            let (rotation, motion, root_motion) = (&kin.rotation[body], &kin.motion[body], &kin.motion[root]);
            let (body_position, origin) = (kin.position[body], kin.origin[body]);
            let rate = motion.angular.norm();
            let relative_rate = if body == root { 0.0 } else { (motion.angular - root_motion.angular).norm() };
            for moving in &self.moving[carrier.shapes.clone()] {
                let (shape, geometry) = (moving.shape, &moving.geometry);
                let position = body_position + rotation * moving.position;
                let placed = &mut self.placed[shape];
                placed.position = position;
                match geometry {
                    Geometry::Sphere { .. } => {}
                    Geometry::Capsule { .. } => placed.rotation.set_column(2, &(rotation * moving.rotation.column(2))),
                    _ => placed.rotation = rotation * moving.rotation,
                }
                let arm = position - origin;
                let velocity = motion.linear + motion.angular.cross(&arm);
                let spin_speed = rate * moving.extent;
                self.travel[shape] = Travel { velocity, spin_speed };
                let bounds = bounds_of(geometry, placed, 0.0);
                self.bounds.set(shape, cull_group, bounds.inflated(margin(velocity.norm() + spin_speed)));
                if carrier.in_tree {
                    let relative_speed = if body == root {
                        0.0
                    } else {
                        let of_root = root_motion.linear + root_motion.angular.cross(&arm);
                        (velocity - of_root).norm() + relative_rate * moving.extent
                    };
                    self.kin_bounds.set(shape, cull_group, bounds.inflated(margin(relative_speed)));
                }
            }
        }
    }

    /// Appends every contact point that two shapes may reach within `dt` s; points of one body pair stand together. Cull groups
    /// at rest are left out.
    pub fn find(&mut self, model: &Model, materials: &[Material], resting: &[bool], dt: f64, out: &mut Vec<Contact>) {
        for pair in &model.pairs {
            if resting[pair.a] | resting[pair.b] {
                continue;
            }
            let bounds = if pair.one_tree { &self.kin_bounds } else { &self.bounds };
            let (group_a, group_b) = (&bounds.cull_groups[pair.a], &bounds.cull_groups[pair.b]);
            if !group_a.overlaps(group_b) {
                continue;
            }
            let partners = if pair.by_b { group_a } else { group_b };
            for (shape, range) in &pair.rows {
                let own = &bounds.shapes[usize::from(*shape)];
                if !own.overlaps(partners) {
                    continue;
                }
                for partner in &pair.partners[range.clone()] {
                    if own.overlaps(&bounds.shapes[usize::from(*partner)]) {
                        let (a, b) = if pair.by_b { (partner, shape) } else { (shape, partner) };
                        let (a, b) = (usize::from(*a), usize::from(*b));
                        let (x, y) = (&self.travel[a], &self.travel[b]);
                        let speed = (x.velocity - y.velocity).norm() + x.spin_speed + y.spin_speed;
                        let margin = REST_MARGIN + (dt * speed).min(MAX_SPEED_MARGIN);
                        collide_pair(model, materials, &self.placed, &mut self.scratch, a, b, margin, out);
                    }
                }
            }
        }
    }
}

impl Collider {
    /// True if the bounds of two shapes of a pair of cull groups overlap: a step would look for contact between them.
    pub fn is_near(&self, model: &Model, pair: usize) -> bool {
        let (pair, bounds) = (&model.pairs[pair], &self.bounds);
        let (group_a, group_b) = (&bounds.cull_groups[pair.a], &bounds.cull_groups[pair.b]);
        let partners = if pair.by_b { group_a } else { group_b };
        group_a.overlaps(group_b)
            && pair.rows.iter().any(|(shape, range)| {
                let own = &bounds.shapes[usize::from(*shape)];
                let near = |partner: &u16| own.overlaps(&bounds.shapes[usize::from(*partner)]);
                own.overlaps(partners) && pair.partners[range.clone()].iter().any(near)
            })
    }

    /// Appends the contact points of pairs of cull groups, given by index, as if all stood still.
    pub fn find_still(&mut self, model: &Model, materials: &[Material], pairs: &[usize], out: &mut Vec<Contact>) {
        for pair in pairs.iter().map(|&pair| &model.pairs[pair]) {
            for (shape, range) in &pair.rows {
                let own = self.bounds.shapes[usize::from(*shape)];
                for partner in &pair.partners[range.clone()] {
                    if own.overlaps(&self.bounds.shapes[usize::from(*partner)]) {
                        let (a, b) = if pair.by_b { (partner, shape) } else { (shape, partner) };
                        let (a, b) = (usize::from(*a), usize::from(*b));
                        collide_pair(model, materials, &self.placed, &mut self.scratch, a, b, REST_MARGIN, out);
                    }
                }
            }
        }
    }
}

impl Model {
    /// Pairs of shapes that may touch: not those of one body, of bodies joined by a joint, or excluded.
    pub fn shape_pairs(&self) -> impl Iterator<Item = (ShapeId, ShapeId)> + '_ {
        self.pairs
            .iter()
            .flat_map(|pair| {
                pair.rows.iter().flat_map(move |(shape, range)| {
                    let partners = pair.partners[range.clone()].iter();
                    partners.map(move |partner| if pair.by_b { (partner, shape) } else { (shape, partner) })
                })
            })
            .map(|(a, b)| (ShapeId(usize::from(*a)), ShapeId(usize::from(*b))))
    }

    /// Every contact of a configuration with a gap of at most `margin` m, shapes unmoved. Allocates; for building and
    /// checking scenes, not for stepping.
    ///
    /// # Errors
    /// A `qpos` of the wrong length or with an entry that is not finite.
    pub fn contacts_at(&self, qpos: &[f64], margin: f64) -> Result<Vec<Contact>, ModelError> {
        check_array("qpos", qpos, self.nq)?;
        let mut kin = Kinematics::new(self);
        kin.update(self, &State { qpos: qpos.to_vec(), qvel: vec![0.0; self.nv] });
        let mut collider = Collider::new(self);
        collider.update(&kin, 0.0);
        let mut found = Vec::new();
        for (a, b) in self.shape_pairs() {
            let (placed, scratch) = (&collider.placed, &mut collider.scratch);
            collide_pair(self, &self.nominal.materials, placed, scratch, a.0, b.0, margin, &mut found);
        }
        Ok(found)
    }
}

#[inline(always)]
fn bounds_of(geometry: &Geometry, placed: &Placed, margin: f64) -> Aabb {
    let Some([low, high]) = geometry.bounds(&placed.rotation) else {
        let up = placed.rotation[(2, 2)] == 1.0;
        let top = if up { placed.position.z + margin } else { 1e30 };
        return Aabb { min: V3::repeat(-1e30), max: V3::new(1e30, 1e30, top) };
    };
    Aabb { min: placed.position + low, max: placed.position + high }.inflated(margin)
}

fn grow(target: &mut Aabb, other: &Aabb) {
    for k in 0..3 {
        target.min[k] = if other.min[k] < target.min[k] { other.min[k] } else { target.min[k] };
        target.max[k] = if other.max[k] > target.max[k] { other.max[k] } else { target.max[k] };
    }
}

fn collide_pair(
    model: &Model,
    materials: &[Material],
    placed: &[Placed],
    scratch: &mut Scratch,
    a: usize,
    b: usize,
    margin: f64,
    out: &mut Vec<Contact>,
) {
    use Geometry::{Capsule, Cuboid as Box, HalfSpace, Hull, Sphere};
    let Material { friction, torsion, rolling, .. } = materials[a].pair(&materials[b]);
    let geometry = |shape: usize| &model.shapes[shape].geometry;
    // Each pair of kinds is written once, in the order of the ranks.
    let swapped = rank(geometry(a)) > rank(geometry(b));
    let (first, second) = if swapped { (b, a) } else { (a, b) };
    let push = &mut |point: Point| {
        let point = if swapped { point.flipped() } else { point };
        out.push(Contact {
            shape_a: ShapeId(a),
            shape_b: ShapeId(b),
            position: point.position,
            normal: point.normal,
            distance: point.distance,
            friction,
            torsion,
            rolling,
            force: V3::zeros(),
        });
    };
    let (pa, pb) = (&placed[first], &placed[second]);
    match (geometry(first), geometry(second)) {
        (HalfSpace, Hull(hull)) => polyhedra::half_space_hull(&mut scratch.hull, pa, (pb, hull), margin, push),
        (HalfSpace, Box { half_extents }) => closed_form::half_space_box(pa, pb, half_extents, margin, push),
        (HalfSpace, Sphere { radius }) => closed_form::half_space_ball(pa, pb.position, *radius, margin, push),
        (HalfSpace, Capsule { radius, half_length }) => {
            closed_form::half_space_capsule(pa, pb, *radius, *half_length, margin, push);
        }
        (Hull(_), Hull(_) | Box { .. }) => {
            if let (Some(ha), Some(hb)) = (&scratch.hulls[first], &scratch.hulls[second]) {
                polyhedra::hull_hull(&mut scratch.hull, (pa, ha), (pb, hb), margin, push);
            }
        }
        (Hull(hull), Sphere { radius }) => {
            closed_form::convex_ball(pa, |p| hull.distance(p), pb.position, *radius, margin, push);
        }
        (Hull(hull), Capsule { radius, half_length }) => {
            closed_form::convex_capsule(pa, &**hull, pb, *radius, *half_length, margin, push);
        }
        (Box { half_extents: ha }, Box { half_extents: hb }) => {
            box_box(&mut scratch.manifold, (pa, ha), (pb, hb), margin, push);
        }
        (Box { half_extents }, Sphere { radius }) => {
            closed_form::convex_ball(pa, |p| box_distance(p, half_extents), pb.position, *radius, margin, push);
        }
        (Box { half_extents }, Capsule { radius, half_length }) => {
            let body = BoxAt { half: half_extents };
            closed_form::convex_capsule(pa, &body, pb, *radius, *half_length, margin, push);
        }
        (Sphere { radius: ra }, Sphere { radius: rb }) => {
            closed_form::ball_ball(pa.position, *ra, pb.position, *rb, margin, push);
        }
        (Sphere { radius: ra }, Capsule { radius, half_length }) => {
            closed_form::ball_capsule(pa.position, *ra, pb, *radius, *half_length, margin, push);
        }
        (Capsule { radius: ra, half_length: ha }, Capsule { radius: rb, half_length: hb }) => {
            closed_form::capsule_capsule((pa, *ra, *ha), (pb, *rb, *hb), margin, push);
        }
        // Half-spaces stand still, and the ranks rule out the rest.
        _ => {}
    }
}

/// Kinds of geometry in the order in which [`collide_pair`] takes them.
#[inline(always)]
fn rank(geometry: &Geometry) -> u8 {
    match geometry {
        Geometry::HalfSpace => 0,
        Geometry::Hull(_) => 1,
        Geometry::Cuboid { .. } => 2,
        Geometry::Sphere { .. } => 3,
        Geometry::Capsule { .. } => 4,
    }
}

/// Two boxes, by parry's separating axes and face clipping on a fresh manifold.
fn box_box(
    manifold: &mut ContactManifold<(), ()>,
    (a, half_a): (&Placed, &V3),
    (b, half_b): (&Placed, &V3),
    margin: f64,
    out: &mut impl FnMut(Point),
) {
    let (a_from_b, [half_a, half_b]) = (pose_between(a, b), [half_a, half_b].map(vector));
    let (box_a, box_b) = (Cuboid::new(half_a), Cuboid::new(half_b));
    manifold.points.clear();
    manifold.local_n1 = Vector::ZERO;
    contact_manifold_cuboid_cuboid(&a_from_b, &box_a, &box_b, margin, manifold);
    let world = |v: Vector| a.rotation * V3::new(v.x, v.y, v.z);
    let normal = world(manifold.local_n1);
    for point in manifold.points.iter().filter(|p| p.dist <= margin) {
        let on_a = a.position + world(point.local_p1);
        out(Point { position: on_a + normal * (0.5 * point.dist), normal, distance: point.dist });
    }
    let apart = manifold.points.iter().all(|p| p.dist > 0.0) && manifold.local_n1 != Vector::ZERO;
    if apart {
        nearest(a, &a_from_b, &box_a, &box_b, margin, out);
    }
}
