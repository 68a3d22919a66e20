//! Readings of a state against differences of other readings: a Jacobian is a derivative, a bias force that of momentum.

use fiatlux_dynamics::*;
use nalgebra::{Isometry3, Matrix3, UnitQuaternion, UnitVector3, Vector3};

const ROOT: BodyId = BodyId(2);
const HAND: BodyId = BodyId(5);

/// A ball, then a tree of a free root with three links one after another and a fourth next to them.
fn model() -> Model {
    let mut builder = ModelBuilder::new();
    let mut add = |name: &str, parent: usize, axis: Option<[f64; 3]>| {
        let joint = axis.map_or(Joint::Free, |axis| {
            let axis = UnitVector3::new_normalize(Vector3::from(axis));
            Joint::Hinge(Hinge { axis, lower: -2.0, upper: 2.0, armature: 0.02, drive: None })
        });
        let turn = UnitQuaternion::from_euler_angles(0.3, -0.2, 0.5);
        let spec = BodySpec {
            name: name.into(),
            parent: BodyId(parent),
            parent_from_body: Isometry3::from_parts(Vector3::new(0.1, -0.05, 0.2).into(), turn),
            joint,
            mass: 1.0 + parent as f64,
            com: Vector3::new(0.02, 0.01, 0.08),
            inertia: Matrix3::from_diagonal(&Vector3::new(0.02, 0.025, 0.015)),
        };
        builder.add_body(spec).unwrap();
    };
    add("ball", 0, None);
    add("root", 0, None);
    add("arm", 2, Some([0.0, 1.0, 0.2]));
    add("forearm", 3, Some([1.0, 0.0, 0.3]));
    add("hand", 4, Some([0.0, 0.2, 1.0]));
    add("tail", 2, Some([1.0, 1.0, 0.0]));
    builder.build().unwrap()
}

fn state(model: &Model) -> State {
    let mut state = model.reference_state();
    state.set_pose(
        model,
        ROOT,
        &Isometry3::from_parts(Vector3::new(0.4, 0.3, 1.0).into(), UnitQuaternion::from_euler_angles(0.4, 0.2, -0.7)),
    );
    let dof = |index: usize| (index as f64 * 0.7).sin();
    state.qvel.iter_mut().enumerate().for_each(|(index, v)| *v = dof(index));
    state.qpos[14..].iter_mut().enumerate().for_each(|(index, q)| *q = 0.8 * dof(index + 3));
    state
}

/// The state `dt` s later, velocities kept.
fn moved(model: &Model, state: &State, dt: f64) -> State {
    let mut later = state.clone();
    for body in &model.bodies()[1..] {
        let (q, v) = (body.qpos_start, body.dof_start);
        if body.spec.joint != Joint::Free {
            later.qpos[q] += dt * state.qvel[v];
            continue;
        }
        let part = |at: usize| Vector3::from_column_slice(&state.qvel[at..at + 3]) * dt;
        let at = &state.qpos[q..q + 7];
        let turned = UnitQuaternion::from_scaled_axis(part(v + 3))
            * UnitQuaternion::new_normalize(nalgebra::Quaternion::new(at[3], at[4], at[5], at[6]));
        let pose = Isometry3::from_parts((Vector3::from_column_slice(&at[..3]) + part(v)).into(), turned);
        later.set_pose(model, model.body(&body.spec.name).unwrap(), &pose);
    }
    later
}

fn times(rows: &[f64], v: &[f64]) -> Vec<f64> {
    rows.chunks(v.len()).map(|row| row.iter().zip(v).map(|(a, b)| a * b).sum()).collect()
}

fn close(a: &[f64], b: &[f64], tolerance: f64, what: &str) {
    let gap = a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(a.len() == b.len() && gap < tolerance, "{what}: {a:?} and {b:?} differ by {gap}");
}

#[test]
fn jacobians_are_the_derivatives_of_poses() {
    let model = model();
    let (state, nv) = (state(&model), model.nv());
    let site = Site { body: HAND, body_from_site: Isometry3::translation(0.05, 0.1, -0.02) };
    let mut mechanics = Mechanics::new(&model);
    let (mut jacobian, mut of_com) = (vec![1.0; 6 * nv], vec![1.0; 3 * nv]);
    mechanics.update(&model, &state);
    mechanics.jacobian(&model, &site, &mut jacobian);
    mechanics.com_jacobian(&model, ROOT, &mut of_com);
    let (velocity, com_velocity) = (mechanics.site_velocity(&site), mechanics.com_velocity(&model, ROOT));
    let spatial = times(&jacobian, &state.qvel);
    close(&spatial[..3], velocity.linear.as_slice(), 1e-12, "velocity");
    close(&spatial[3..], velocity.angular.as_slice(), 1e-12, "angular velocity");
    close(&times(&of_com, &state.qvel), com_velocity.as_slice(), 1e-12, "velocity of the centre of mass");

    let dt = 1e-6;
    let mut read = |dt: f64| {
        mechanics.update(&model, &moved(&model, &state, dt));
        (mechanics.world_from_site(&site), mechanics.center_of_mass(&model, ROOT).1)
    };
    let ((before, com_before), (after, com_after)) = (read(-dt), read(dt));
    let shift = (after.translation.vector - before.translation.vector) / (2.0 * dt);
    let turn = (after.rotation * before.rotation.inverse()).scaled_axis() / (2.0 * dt);
    close(&spatial[..3], shift.as_slice(), 1e-8, "difference of positions");
    close(&spatial[3..], turn.as_slice(), 1e-8, "difference of rotations");
    close(com_velocity.as_slice(), ((com_after - com_before) / (2.0 * dt)).as_slice(), 1e-8, "centres of mass");

    let fixed = Site { body: BodyId::WORLD, body_from_site: Isometry3::translation(1.0, 0.0, 0.0) };
    mechanics.jacobian(&model, &fixed, &mut jacobian);
    assert!(jacobian.iter().all(|entry| *entry == 0.0) && mechanics.site_velocity(&fixed).linear.norm() == 0.0);
}

#[test]
fn inverse_dynamics_gives_back_what_a_step_was_given() {
    let model = model();
    let (state, nv) = (state(&model), model.nv());
    let mut mechanics = Mechanics::new(&model);
    mechanics.update_equation(&model, &state);
    // A force at a point of the hand, as a wrench at its centre of mass and as generalised forces.
    let (force, point) = (Vector3::new(3.0, -2.0, 5.0), Vector3::new(0.3, 0.2, 1.4));
    let com = mechanics.world_point(HAND, &mechanics.body_com(&model, HAND));
    let wrench = Wrench { force, torque: (point - com).cross(&force) };
    let dt = 1e-5;
    let mut after = state.clone();
    let report =
        Dynamics::new(&model).step(&model, &mut after, &Input { wrenches: &[(HAND, wrench)], ..Input::default() }, dt);
    assert!(report.converged);
    let acceleration: Vec<f64> = after.qvel.iter().zip(&state.qvel).map(|(a, b)| (a - b) / dt).collect();
    let mut forces = vec![0.0; nv];
    mechanics.inverse_dynamics(&model, &acceleration, &mut forces);
    mechanics.add_force(&model, HAND, &point, &-force, &mut forces);
    close(&forces, &vec![0.0; nv], 1e-2, "forces");

    let mut matrix = vec![0.0; nv * nv];
    mechanics.mass_matrix(&model, &mut matrix);
    let mut dense = times(&matrix, &acceleration);
    dense.iter_mut().zip(mechanics.bias_force()).for_each(|(sum, bias)| *sum += bias);
    mechanics.inverse_dynamics(&model, &acceleration, &mut forces);
    close(&forces, &dense, 1e-9, "mass matrix times acceleration");
}

/// Inverse kinematics relies on this: a part of the bodies is updated, the others stay as they were.
#[test]
fn an_update_of_some_bodies_is_that_of_all_for_these() {
    let model = model();
    let start = state(&model);
    let mut turned = start.clone();
    let arm = model.bodies()[4].qpos_start;
    turned.qpos[arm..arm + 3].iter_mut().for_each(|q| *q += 0.3);
    let (mut all, mut part) = (Mechanics::new(&model), Mechanics::new(&model));
    part.update(&model, &start);
    let before = part.world_from_body(BodyId(6));
    part.update_bodies(&model, &turned, &[BodyId(4), HAND]);
    all.update(&model, &turned);
    assert_eq!(part.world_from_body(HAND), all.world_from_body(HAND));
    assert_eq!(part.world_from_body(BodyId(6)), before);
    assert_ne!(all.world_from_body(BodyId(6)), before);
}
