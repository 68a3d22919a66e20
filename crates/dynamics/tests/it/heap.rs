//! Many free bodies.

use fiatlux_dynamics::*;
use nalgebra::{Isometry3, Matrix3, UnitQuaternion, Vector3};

const DT: f64 = 0.005;
const HALF: Vector3<f64> = Vector3::new(0.06, 0.05, 0.04);

/// A floor with a wall on each side, and boxes at these poses.
fn boxes(poses: &[Isometry3<f64>]) -> (Model, State) {
    let mut builder = ModelBuilder::new();
    let mut shapes = 0;
    let mut shape = |builder: &mut ModelBuilder, body: BodyId, pose, geometry| {
        let name = format!("shape {shapes}");
        shapes += 1;
        let (material, cull_group) = (Material::new(0.5, 0), body.0 as u16);
        let spec = ShapeSpec { name, body, body_from_shape: pose, geometry, material, cull_group, label: 0 };
        builder.add_shape(spec).unwrap();
    };
    let bodies = (0..poses.len()).map(|k| {
        let square = HALF.component_mul(&HALF);
        let moments = Vector3::new(square.y + square.z, square.x + square.z, square.x + square.y) / 3.0;
        let spec = BodySpec {
            name: format!("box {k}"),
            parent: BodyId::WORLD,
            parent_from_body: Isometry3::identity(),
            joint: Joint::Free,
            mass: 1.0,
            com: Vector3::zeros(),
            inertia: Matrix3::from_diagonal(&moments),
        };
        let body = builder.add_body(spec).unwrap();
        shape(&mut builder, body, Isometry3::identity(), Geometry::Cuboid { half_extents: HALF });
        body
    });
    let bodies: Vec<BodyId> = bodies.collect();
    shape(&mut builder, BodyId::WORLD, Isometry3::identity(), Geometry::HalfSpace);
    for (x, y) in [(0.4, 0.0), (-0.4, 0.0), (0.0, 0.4), (0.0, -0.4)] {
        let half_extents = Vector3::new(if x == 0.0 { 0.5 } else { 0.1 }, if y == 0.0 { 0.5 } else { 0.1 }, 0.3);
        shape(&mut builder, BodyId::WORLD, Isometry3::translation(x, y, 0.3), Geometry::Cuboid { half_extents });
    }
    let model = builder.build().unwrap();
    let mut state = model.reference_state();
    for (body, pose) in bodies.iter().zip(poses) {
        state.set_pose(&model, *body, pose);
    }
    (model, state)
}

/// A pose of a pile before it falls.
fn falling(k: usize) -> Isometry3<f64> {
    let (layer, place) = (k / 4, k % 4);
    let x = 0.18 * (place % 2) as f64 - 0.09 + 0.01 * (layer % 3) as f64;
    let y = 0.18 * (place / 2) as f64 - 0.09;
    let turn = UnitQuaternion::from_euler_angles(0.3 * layer as f64, 0.2 * place as f64, 0.5 * k as f64);
    Isometry3::from_parts(Vector3::new(x, y, 0.12 + 0.18 * layer as f64).into(), turn)
}

#[test]
fn thirty_two_boxes_fall_into_a_heap_and_come_to_rest() {
    let poses: Vec<_> = (0..32).map(falling).collect();
    let (model, mut state) = boxes(&poses);
    assert_eq!(model.nv(), 192);
    let mut dynamics = Dynamics::new(&model);
    let mut deepest = 0.0_f64;
    for _ in 0..800 {
        let report = dynamics.step(&model, &mut state, &Input::default(), DT);
        assert!(report.converged);
        deepest = deepest.max(report.penetration);
    }
    let speed = state.qvel.iter().fold(0.0_f64, |most, v| most.max(v.abs()));
    assert!(speed < 0.01, "{speed}");
    assert!(deepest < 0.01, "{deepest} m deep");
    let heights: Vec<f64> = state.qpos.chunks(7).map(|pose| pose[2]).collect();
    let stacked = heights.iter().filter(|height| **height > 0.1).count();
    assert!(heights.iter().all(|height| *height > 0.035) && stacked > 8, "{heights:?}");
    let weight = 32.0 * DEFAULT_GRAVITY;
    let up: f64 = model_forces(&model, &dynamics);
    assert!((up / weight - 1.0).abs() < 0.01, "{up} N, not {weight} N");
}

/// Upward force of floor and walls on the boxes, N.
fn model_forces(model: &Model, dynamics: &Dynamics) -> f64 {
    let on_world = |shape: ShapeId| model.shapes()[shape.0].body == BodyId::WORLD;
    let upward =
        dynamics.contacts().iter().map(|contact| match (on_world(contact.shape_a), on_world(contact.shape_b)) {
            (true, _) => contact.force.z,
            (_, true) => -contact.force.z,
            _ => 0.0,
        });
    upward.sum()
}

/// Bodies that touch nothing do not change the others by a bit, though the rows of all no longer fit in one word.
#[test]
fn a_wide_model_moves_as_a_narrow_one() {
    let mut poses: Vec<_> = (0..8).map(falling).collect();
    let (narrow, mut expected) = boxes(&poses);
    poses.extend((0..24).map(|k| Isometry3::translation(0.0, 0.0, 50.0 + f64::from(k))));
    let (wide, mut state) = boxes(&poses);
    assert!(narrow.nv() <= 128 && wide.nv() > 128);
    let (mut narrow_dynamics, mut wide_dynamics) = (Dynamics::new(&narrow), Dynamics::new(&wide));
    for step in 0..200 {
        narrow_dynamics.step(&narrow, &mut expected, &Input::default(), DT);
        wide_dynamics.step(&wide, &mut state, &Input::default(), DT);
        assert_eq!(state.qpos[..narrow.nq()], expected.qpos[..], "step {step}");
        assert_eq!(state.qvel[..narrow.nv()], expected.qvel[..], "step {step}");
    }
    assert!(narrow_dynamics.contacts().len() > 16, "the boxes must touch");
}
