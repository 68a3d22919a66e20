//! Signed distances and nearest points: against parry's queries of whole shapes, and by what they must mean.

use fiatlux_dynamics::*;
use nalgebra::{Isometry3, Translation3, Vector3};

use crate::contact_points::{Random, free_body, parry_pose, parry_shape, two_shapes};

fn placed(model: &Model, poses: [&Isometry3<f64>; 2]) -> Mechanics {
    let mut state = model.reference_state();
    state.set_pose(model, BodyId(1), poses[0]);
    state.set_pose(model, BodyId(2), poses[1]);
    let mut mechanics = Mechanics::new(model);
    mechanics.update(model, &state);
    mechanics
}

const SHAPES: [ShapeId; 2] = [ShapeId(0), ShapeId(1)];

#[test]
fn distances_agree_with_a_general_convex_query() {
    let mut counts = [0; 2];
    for kinds in [(0, 0), (0, 1), (1, 1), (2, 0), (1, 2), (2, 1), (2, 2), (3, 0), (1, 3), (3, 2), (3, 3)] {
        let mut random = Random(70 + 10 * kinds.0 as u64 + kinds.1 as u64);
        for case in 0..200 {
            let (a, b) = (random.geometry(kinds.0), random.geometry(kinds.1));
            let (pose_a, pose_b) = (random.pose(0.2), random.pose(0.2));
            let model = two_shapes(a.clone(), b.clone());
            let nearest =
                placed(&model, [&pose_a, &pose_b]).nearest(&model, SHAPES[0], SHAPES[1], f64::INFINITY).unwrap();
            let theirs = parry3d_f64::query::contact(
                &parry_pose(&pose_a),
                &*parry_shape(&a),
                &parry_pose(&pose_b),
                &*parry_shape(&b),
                10.0,
            );
            let theirs = theirs.unwrap().unwrap().dist;
            // A segment inside a box, and an axis of a capsule that meets another, have more than one way out.
            if theirs > -0.02 {
                let (ours, case) = (nearest.distance, format!("{kinds:?} case {case}"));
                // Parry's query of round shapes ends a little early: no gap is smaller than the smallest.
                assert!(ours < theirs + 1e-9 && ours > theirs - 1e-4, "{case}: {ours} against {theirs}");
                counts[usize::from(ours < 0.0)] += 1;
            }
            // The two points are that far apart, along the normal, and the second shape touches when it has moved that far.
            let [on_a, on_b] = nearest.points;
            assert!((on_b - on_a - nearest.normal * nearest.distance).norm() < 1e-9, "{nearest:?}");
            let moved = Translation3::from(nearest.normal * -nearest.distance) * pose_b;
            let touching = placed(&model, [&pose_a, &moved]).nearest(&model, SHAPES[0], SHAPES[1], 1.0).unwrap();
            assert!(touching.distance.abs() < 1e-6, "{kinds:?} case {case}: {touching:?} after {nearest:?}");
        }
    }
    assert!(counts.iter().all(|count| *count > 50), "{counts:?}");
}

#[test]
fn a_floor_has_distances_and_the_nearest_of_several_pairs_is_found() {
    let mut builder = ModelBuilder::new();
    builder.add_body(free_body("a")).unwrap();
    let ball = || Geometry::Sphere { radius: 0.1 };
    let shapes =
        [("floor", Geometry::HalfSpace, 0.0), ("high", ball(), 3.0), ("low", ball(), 0.25), ("deep", ball(), -0.05)];
    for (index, (name, geometry, height)) in shapes.into_iter().enumerate() {
        let shape = ShapeSpec {
            name: name.into(),
            body: BodyId::WORLD,
            body_from_shape: Isometry3::translation(0.3 * index as f64, 0.0, height),
            geometry,
            material: Material::new(1.0, 0),
            cull_group: 0,
            label: 0,
        };
        builder.add_shape(shape).unwrap();
    }
    let model = builder.build().unwrap();
    let mut mechanics = Mechanics::new(&model);
    let low = mechanics.nearest(&model, ShapeId(0), ShapeId(2), 1.0).unwrap();
    assert!((low.distance - 0.15).abs() < 1e-12 && (low.normal - Vector3::z()).norm() < 1e-12, "{low:?}");
    assert!((low.points[0] - Vector3::new(0.6, 0.0, 0.0)).norm() < 1e-12, "{low:?}");
    let back = mechanics.nearest(&model, ShapeId(2), ShapeId(0), 1.0).unwrap();
    assert_eq!((back.normal, back.points), (-low.normal, [low.points[1], low.points[0]]));
    assert_eq!(mechanics.nearest(&model, ShapeId(0), ShapeId(1), 1.0), None);
    assert_eq!(mechanics.nearest(&model, ShapeId(0), ShapeId(0), 1.0), None);
    let pairs = [1, 2, 3].map(|index| (ShapeId(0), ShapeId(index)));
    let (index, deep) = mechanics.gaps(&model).nearest_pair(&pairs, f64::INFINITY).unwrap();
    assert!(index == 2 && (deep.distance + 0.15).abs() < 1e-12, "{index}: {deep:?}");
    assert_eq!(mechanics.gaps(&model).nearest_pair(&pairs[..1], 0.5), None);
}

/// The bound of a search changes nothing within it, for long shapes as well.
#[test]
fn a_bound_leaves_out_what_is_wider_and_changes_nothing_else() {
    let mut counts = [0; 2];
    for kinds in [(0, 0), (0, 1), (1, 1), (2, 0), (1, 2), (2, 1), (2, 2), (3, 0), (1, 3), (3, 2), (3, 3)] {
        let mut random = Random(900 + 10 * kinds.0 as u64 + kinds.1 as u64);
        for case in 0..400 {
            let long = if case % 2 == 0 { 1.0 } else { 12.0 };
            let a = match random.geometry(kinds.0) {
                Geometry::Capsule { radius, half_length } => {
                    Geometry::Capsule { radius, half_length: long * half_length }
                }
                Geometry::Cuboid { half_extents: h } => {
                    Geometry::Cuboid { half_extents: Vector3::new(long * h.x, h.y, h.z) }
                }
                other => other,
            };
            let model = two_shapes(a, random.geometry(kinds.1));
            let mut placed = placed(&model, [&random.pose(0.2), &random.pose(0.3)]);
            let [first, second] = SHAPES;
            let whole = placed.nearest(&model, first, second, f64::INFINITY).unwrap();
            for most in [-0.02, -0.005] {
                assert_eq!(placed.gaps(&model).any_within(&[(first, second)], most), whole.distance <= most);
            }
            for most in [0.0, 0.005, 0.03, 0.1] {
                let found = placed.nearest(&model, first, second, most).filter(|found| found.distance <= most);
                let expected = Some(whole).filter(|whole| whole.distance <= most);
                assert_eq!(found, expected, "{kinds:?} case {case}, within {most}: {whole:?}");
                let gaps = placed.gaps(&model);
                assert_eq!(gaps.nearest(first, second, most).filter(|found| found.distance <= most), expected);
                assert_eq!(gaps.any_within(&[(first, second)], most), expected.is_some());
                counts[usize::from(expected.is_some())] += 1;
            }
        }
    }
    assert!(counts.iter().all(|count| *count > 2000), "{counts:?}");
}
