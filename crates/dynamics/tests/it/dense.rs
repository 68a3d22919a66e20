//! The solve of a step against a dense one.

use fiatlux_dynamics::*;
use nalgebra::{DMatrix, DVector, Isometry3, Matrix3, UnitQuaternion, Vector3};

use crate::mass_matrix;

const DT: f64 = 0.005;

/// A floating arm of ten joints with a hand: a finger of three links, one of a single link, and one that branches.
fn arm() -> Model {
    let mut builder = ModelBuilder::new();
    builder.add_body(body("root", BodyId::WORLD, Joint::Free, 5.0)).unwrap();
    for link in 1..=10 {
        builder.add_body(body(&format!("arm {link}"), BodyId(link), hinge(link), 1.0)).unwrap();
    }
    let hand = 11;
    for (link, parent) in [hand, 12, 13, hand, hand, 16, 16].into_iter().enumerate() {
        builder.add_body(body(&format!("finger {link}"), BodyId(parent), hinge(link), 0.01)).unwrap();
    }
    builder.build().unwrap()
}

fn body(name: &str, parent: BodyId, joint: Joint, mass: f64) -> BodySpec {
    let turn = Vector3::new(0.3, -0.2, 0.5);
    BodySpec {
        name: name.into(),
        parent,
        parent_from_body: Isometry3::new(Vector3::new(0.02, 0.05, -0.1), turn),
        joint,
        mass,
        com: Vector3::new(0.01, -0.02, 0.03),
        inertia: Matrix3::from_diagonal(&Vector3::new(1.0, 1.2, 0.8)) * (mass * 0.01),
    }
}

fn hinge(index: usize) -> Joint {
    let axis = [Vector3::x_axis(), Vector3::y_axis(), Vector3::z_axis()][index % 3];
    let drive = Drive { stiffness: 3.0, damping: 0.1, effort_limit: f64::INFINITY, speed_limit: f64::INFINITY };
    Joint::Hinge(Hinge { axis, lower: f64::NEG_INFINITY, upper: f64::INFINITY, armature: 1e-4, drive: Some(drive) })
}

/// Without limits and contact a step is linear in the velocity. Fingers are eliminated apart from the rest of their tree.
#[test]
fn a_step_without_contact_solves_the_dense_equation() {
    let model = arm();
    let mut state = model.reference_state();
    for (dof, velocity) in state.qvel.iter_mut().enumerate() {
        *velocity = 0.5 * f64::sin(1.0 + dof as f64);
    }
    let targets: Vec<f64> = (0..model.drives().len()).map(|k| 0.2 * f64::cos(k as f64)).collect();
    let mut dynamics = Dynamics::new(&model);

    // Velocities change in the middle of the step.
    let mut middle = state.clone();
    for (q, v) in middle.qpos[7..].iter_mut().zip(&state.qvel[6..]) {
        *q += 0.5 * DT * v;
    }
    let moved = |at: usize| Vector3::from_column_slice(&state.qvel[at..at + 3]) * (0.5 * DT);
    let mut world_from_root = model.bodies()[1].spec.parent_from_body;
    world_from_root.translation.vector += moved(0);
    world_from_root.rotation = UnitQuaternion::from_scaled_axis(moved(3)) * world_from_root.rotation;
    middle.set_pose(&model, BodyId(1), &world_from_root);

    let n = model.nv();
    let mut mechanics = Mechanics::new(&model);
    mechanics.update_equation(&model, &middle);
    let mass = DMatrix::from_row_slice(n, n, &mass_matrix(&model, &middle));
    let bias = DVector::from_column_slice(mechanics.bias_force());
    let before = DVector::from_column_slice(&state.qvel);
    let (mut hessian, mut momentum) = (mass.clone(), &mass * &before - bias * DT);
    for ((&(body, drive), target), k) in model.drives().iter().zip(&targets).zip(0..) {
        let body = &model.bodies()[body.0];
        let (q, dof) = (middle.qpos[body.qpos_start], body.dof_start);
        assert_eq!(dof, 6 + k);
        hessian[(dof, dof)] += DT * (drive.damping + DT * drive.stiffness);
        momentum[dof] += DT * drive.stiffness * (target - q);
    }
    let expected = hessian.cholesky().unwrap().solve(&momentum);

    let report = dynamics.step(&model, &mut state, &Input { targets: &targets, ..Input::default() }, DT);
    assert!(report.converged && report.substeps == 1);
    for (dof, (have, want)) in state.qvel.iter().zip(expected.iter()).enumerate() {
        assert!((have - want).abs() < 1e-6 * expected.norm(), "degree of freedom {dof}: {have}, not {want}");
    }
}
