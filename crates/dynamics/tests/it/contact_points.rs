//! The closed forms of the narrow phase against parry's general convex queries.

use std::sync::Arc;

use fiatlux_dynamics::*;
use nalgebra::{Isometry3, Matrix3, Quaternion, UnitQuaternion, Vector3};

/// A small linear congruential generator: the cases are the same on every machine.
pub struct Random(pub u64);

impl Random {
    pub fn uniform(&mut self, low: f64, high: f64) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        low + (high - low) * (self.0 >> 11) as f64 / (1_u64 << 53) as f64
    }

    pub fn pose(&mut self, spread: f64) -> Isometry3<f64> {
        let mut four = || self.uniform(-1.0, 1.0);
        let rotation = UnitQuaternion::new_normalize(Quaternion::new(four(), four(), four(), four()));
        let mut three = || self.uniform(-spread, spread);
        Isometry3::from_parts(Vector3::new(three(), three(), three()).into(), rotation)
    }

    pub fn geometry(&mut self, kind: usize) -> Geometry {
        match kind {
            0 => Geometry::Sphere { radius: self.uniform(0.02, 0.1) },
            1 => Geometry::Capsule { radius: self.uniform(0.02, 0.06), half_length: self.uniform(0.02, 0.15) },
            2 => {
                let mut size = || self.uniform(0.03, 0.15);
                Geometry::Cuboid { half_extents: Vector3::new(size(), size(), size()) }
            }
            _ => {
                let points = (0..12).map(|_| self.pose(0.1).translation.vector).collect::<Vec<_>>();
                Geometry::Hull(Arc::new(Hull::new("hull", &points).unwrap()))
            }
        }
    }
}

pub fn free_body(name: &str) -> BodySpec {
    BodySpec {
        name: name.into(),
        parent: BodyId::WORLD,
        parent_from_body: Isometry3::identity(),
        joint: Joint::Free,
        mass: 1.0,
        com: Vector3::zeros(),
        inertia: Matrix3::identity(),
    }
}

pub fn two_shapes(a: Geometry, b: Geometry) -> Model {
    let mut builder = ModelBuilder::new();
    for (name, geometry) in [("a", a), ("b", b)] {
        let body = builder.add_body(free_body(name)).unwrap();
        builder
            .add_shape(ShapeSpec {
                name: name.into(),
                body,
                body_from_shape: Isometry3::identity(),
                geometry,
                material: Material::new(1.0, 0),
                cull_group: body.0 as u16,
                label: 0,
            })
            .unwrap();
    }
    builder.build().unwrap()
}

pub fn parry_shape(geometry: &Geometry) -> Box<dyn parry3d_f64::shape::Shape> {
    match *geometry {
        Geometry::Sphere { radius } => Box::new(parry3d_f64::shape::Ball::new(radius)),
        Geometry::Capsule { radius, half_length } => Box::new(parry3d_f64::shape::Capsule::new_z(half_length, radius)),
        Geometry::Cuboid { half_extents: h } => {
            Box::new(parry3d_f64::shape::Cuboid::new(parry3d_f64::math::Vector::new(h.x, h.y, h.z)))
        }
        Geometry::HalfSpace => Box::new(parry3d_f64::shape::HalfSpace::new(parry3d_f64::math::Vector::Z)),
        Geometry::Hull(ref hull) => {
            let points = hull.vertices().iter().map(|p| parry3d_f64::math::Vector::new(p.x, p.y, p.z));
            let points = points.collect::<Vec<_>>();
            Box::new(parry3d_f64::shape::ConvexPolyhedron::from_convex_hull(&points).unwrap())
        }
    }
}

pub fn parry_pose(pose: &Isometry3<f64>) -> parry3d_f64::math::Pose {
    let (p, q) = (pose.translation.vector, pose.rotation);
    parry3d_f64::math::Pose {
        rotation: parry3d_f64::math::Rotation::from_xyzw(q.i, q.j, q.k, q.w),
        translation: parry3d_f64::math::Vector::new(p.x, p.y, p.z),
    }
}

#[test]
fn the_deepest_point_agrees_with_a_general_convex_query() {
    let margin = 0.02;
    let mut compared = 0;
    for kinds in
        [(0, 0), (0, 1), (1, 0), (1, 1), (0, 2), (2, 0), (1, 2), (2, 1), (2, 2), (0, 3), (3, 1), (2, 3), (3, 3)]
    {
        let polyhedra = kinds.0 >= 2 && kinds.1 >= 2;
        let mut random = Random(7 + 10 * kinds.0 as u64 + kinds.1 as u64);
        for case in 0..400 {
            let (a, b) = (random.geometry(kinds.0), random.geometry(kinds.1));
            let (pose_a, pose_b) = (random.pose(0.1), random.pose(0.15));
            let model = two_shapes(a.clone(), b.clone());
            let mut state = model.reference_state();
            state.set_pose(&model, BodyId(1), &pose_a);
            state.set_pose(&model, BodyId(2), &pose_b);
            let found = model.contacts_at(&state.qpos, margin).unwrap();
            let ours = found.iter().map(|c| c.distance).min_by(f64::total_cmp);
            let theirs = parry3d_f64::query::contact(
                &parry_pose(&pose_a),
                &*parry_shape(&a),
                &parry_pose(&pose_b),
                &*parry_shape(&b),
                margin,
            )
            .unwrap()
            .map(|c| c.dist);
            // A capsule whose segment enters a box, and two boxes deep in each other, have more than one way out.
            if theirs.is_some_and(|d| d < -0.015) {
                continue;
            }
            match (ours, theirs) {
                (Some(ours), Some(theirs)) => {
                    compared += 1;
                    // Two ends of a nearly flat stretch may both lie up to half a millimetre above the deepest point.
                    let flat = [(1, 2), (2, 1), (3, 1)].contains(&kinds);
                    let tolerance = if flat { 6e-4 } else { 1e-4 };
                    // Two polyhedra that are apart are measured along a separating axis, not between their nearest points.
                    let apart = polyhedra && theirs > 0.0;
                    assert!(
                        (ours - theirs).abs() < tolerance || apart,
                        "{kinds:?} case {case}: {ours} against {theirs}"
                    );
                }
                (None, Some(d)) => assert!(d > 0.9 * margin, "{kinds:?} case {case}: missed a contact at {d}"),
                (Some(d), None) => {
                    assert!(d > 0.9 * margin || polyhedra, "{kinds:?} case {case}: made up a contact at {d}");
                }
                (None, None) => {}
            }
        }
    }
    assert!(compared > 500, "only {compared} cases compared");
}

/// Plates as thin and as fast as kicking feet, that fly at each other's centres from all sides: each pair meets in the step in
/// which it would pass through.
#[test]
fn thin_boxes_that_fly_at_each_other_do_not_get_deep() {
    let half_extents = Vector3::new(0.101, 0.033, 0.011);
    let model = two_shapes(Geometry::Cuboid { half_extents }, Geometry::Cuboid { half_extents });
    let mut dynamics = Dynamics::new(&model);
    let mut random = Random(11);
    for case in 0..2000 {
        let mut state = model.reference_state();
        let (mut pose_a, mut pose_b) = (random.pose(1.0), random.pose(0.03));
        let speed = random.uniform(5.0, 16.0);
        let direction = pose_a.translation.vector.normalize();
        pose_a.translation.vector = direction * random.uniform(0.25, 0.35);
        pose_b.translation.vector.z += 1.0;
        pose_a.translation.vector.z += 1.0;
        state.set_pose(&model, BodyId(1), &pose_a);
        state.set_pose(&model, BodyId(2), &pose_b);
        state.qvel[..3].copy_from_slice((direction * -speed).as_slice());
        for _ in 0..20 {
            let report = dynamics.step(&model, &mut state, &Input::default(), 0.005);
            assert!(report.penetration < 0.004, "case {case}: {} m deep at {speed} m/s", report.penetration);
        }
    }
}

#[test]
fn normals_point_from_the_first_shape_to_the_second_and_swapping_flips_them() {
    let mut random = Random(3);
    for kinds in [(0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (0, 3), (3, 3), (2, 3)] {
        for _ in 0..200 {
            let (a, b) = (random.geometry(kinds.0), random.geometry(kinds.1));
            let (pose_a, pose_b) = (random.pose(0.1), random.pose(0.1));
            let points = |first: &Geometry, second: &Geometry, p: &Isometry3<f64>, q: &Isometry3<f64>| {
                let model = two_shapes(first.clone(), second.clone());
                let mut state = model.reference_state();
                state.set_pose(&model, BodyId(1), p);
                state.set_pose(&model, BodyId(2), q);
                model.contacts_at(&state.qpos, 0.01).unwrap()
            };
            let (forth, back) = (points(&a, &b, &pose_a, &pose_b), points(&b, &a, &pose_b, &pose_a));
            assert_eq!(forth.len(), back.len());
            for contact in &forth {
                assert!((contact.normal.norm() - 1.0).abs() < 1e-9);
                // Moving b along the normal must part the shapes.
                let mut moved = pose_b;
                moved.translation.vector += contact.normal * 0.5;
                let after = points(&a, &b, &pose_a, &moved);
                assert!(after.iter().all(|c| c.distance > contact.distance), "the normal points inwards");
            }
        }
    }
}
