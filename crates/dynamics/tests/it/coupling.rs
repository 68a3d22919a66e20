//! Joints that follow others, against the virtual work of the uncoupled equation, and what couplings are refused.

use fiatlux_dynamics::*;
use nalgebra::{Isometry3, Matrix3, UnitQuaternion, UnitVector3, Vector3};

use crate::mass_matrix;

const PROXIMAL: BodyId = BodyId(2);
const PEG: BodyId = BodyId(6);
const TIP: BodyId = BodyId(5);
const COUPLINGS: [Coupling; 2] = [
    Coupling { follower: BodyId(4), leader: PROXIMAL, ratio: 1.6, offset: 0.1 },
    Coupling { follower: TIP, leader: PROXIMAL, ratio: -0.7, offset: 0.0 },
];

fn hinge(axis: [f64; 3], drive: Option<Drive>) -> Hinge {
    let axis = UnitVector3::new_normalize(Vector3::from(axis));
    Hinge { axis, lower: -2.5, upper: 2.5, armature: 0.002, drive }
}

/// A palm on the world, a finger of four links of which the third and fourth follow the first, and a peg on the first link and
/// another on the third.
fn builder(drive: Option<Drive>) -> ModelBuilder {
    let mut builder = ModelBuilder::new();
    let mut add = |name: &str, parent: usize, axis: [f64; 3], drive| {
        let turn = UnitQuaternion::from_euler_angles(0.2, -0.1, 0.3);
        let spec = BodySpec {
            name: name.into(),
            parent: BodyId(parent),
            parent_from_body: Isometry3::from_parts(Vector3::new(0.1, 0.02, -0.03).into(), turn),
            joint: Joint::Hinge(hinge(axis, drive)),
            mass: 0.2 + 0.05 * parent as f64,
            com: Vector3::new(0.04, 0.01, 0.005),
            inertia: Matrix3::from_diagonal(&Vector3::new(2e-4, 3e-4, 2.5e-4)),
        };
        builder.add_body(spec).unwrap();
    };
    add("palm", 0, [0.0, 1.0, 0.2], drive);
    add("proximal", 1, [0.0, 1.0, 0.0], drive);
    add("middle", 2, [0.1, 1.0, 0.3], drive);
    add("distal", 3, [0.0, 1.0, -0.2], None);
    add("tip", 4, [0.2, 1.0, 0.0], None);
    add("peg", 2, [1.0, 0.0, 0.1], drive);
    add("thorn", 4, [1.0, 0.2, 0.1], drive);
    builder
}

fn add_ball(builder: &mut ModelBuilder, body: BodyId, at: [f64; 3], radius: f64) {
    let shape = ShapeSpec {
        name: format!("ball {}", body.0),
        body,
        body_from_shape: Isometry3::translation(at[0], at[1], at[2]),
        geometry: Geometry::Sphere { radius },
        material: Material::new(0.5, 0),
        cull_group: body.0 as u16,
        label: 0,
    };
    builder.add_shape(shape).unwrap();
}

fn coupled(mut builder: ModelBuilder) -> Model {
    COUPLINGS.iter().for_each(|&coupling| builder.couple(coupling).unwrap());
    builder.build().unwrap()
}

/// Columns of the matrix from the free velocities to all, one for each joint that follows none.
fn free_columns(model: &Model) -> Vec<Vec<f64>> {
    let follows = |dof: &usize| COUPLINGS.iter().any(|coupling| coupling.follower.0 == dof + 1);
    let column = |dof: usize| {
        let mut column = vec![0.0; model.nv()];
        column[dof] = 1.0;
        for Coupling { follower, leader, ratio, .. } in COUPLINGS {
            column[follower.0 - 1] = if leader.0 == dof + 1 { ratio } else { 0.0 };
        }
        column
    };
    (0..model.nv()).filter(|dof| !follows(dof)).map(column).collect()
}

fn start(model: &Model) -> State {
    let mut state = model.reference_state();
    for (dof, value) in state.qpos.iter_mut().enumerate() {
        *value = 0.3 * (dof as f64 * 1.3).sin();
    }
    for (dof, value) in state.qvel.iter_mut().enumerate() {
        *value = 1.5 * (dof as f64 * 0.9).cos();
    }
    model.follow(&mut state);
    state
}

#[track_caller]
fn assert_follows(state: &State) {
    for Coupling { follower, leader, ratio, offset } in COUPLINGS {
        let (leader, follower) = (leader.0 - 1, follower.0 - 1);
        assert_eq!(state.qpos[follower], ratio * state.qpos[leader] + offset);
        assert_eq!(state.qvel[follower], ratio * state.qvel[leader]);
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Accelerations of the uncoupled equation in the coordinates that are left, where nothing drives or touches.
fn free_accelerations(model: &Model, state: &State) -> Vec<f64> {
    let (matrix, nv, columns) = (mass_matrix(model, state), model.nv(), free_columns(model));
    let mut mechanics = Mechanics::new(model);
    mechanics.update_equation(model, state);
    let times = |column: &Vec<f64>| (0..nv).map(|row| dot(&matrix[row * nv..][..nv], column)).collect::<Vec<_>>();
    let reduced =
        nalgebra::DMatrix::from_fn(columns.len(), columns.len(), |r, c| dot(&columns[r], &times(&columns[c])));
    let bias = nalgebra::DVector::from_fn(columns.len(), |r, _| -dot(&columns[r], mechanics.bias_force()));
    let free = reduced.cholesky().unwrap().solve(&bias);
    (0..nv).map(|dof| (0..columns.len()).map(|c| columns[c][dof] * free[c]).sum()).collect()
}

/// One step of the classical method of fourth order.
fn fourth_order(model: &Model, state: &mut State, dt: f64) {
    let slope = |q: &[f64], v: &[f64]| {
        let state = State { qpos: q.to_vec(), qvel: v.to_vec() };
        (v.to_vec(), free_accelerations(model, &state))
    };
    let after =
        |base: &[f64], slope: &[f64], dt: f64| base.iter().zip(slope).map(|(b, s)| b + dt * s).collect::<Vec<_>>();
    let (q, v) = (state.qpos.clone(), state.qvel.clone());
    let one = slope(&q, &v);
    let two = slope(&after(&q, &one.0, 0.5 * dt), &after(&v, &one.1, 0.5 * dt));
    let three = slope(&after(&q, &two.0, 0.5 * dt), &after(&v, &two.1, 0.5 * dt));
    let four = slope(&after(&q, &three.0, dt), &after(&v, &three.1, dt));
    for dof in 0..q.len() {
        let mean = |k: [&Vec<f64>; 4]| (k[0][dof] + 2.0 * k[1][dof] + 2.0 * k[2][dof] + k[3][dof]) / 6.0;
        state.qpos[dof] += dt * mean([&one.0, &two.0, &three.0, &four.0]);
        state.qvel[dof] += dt * mean([&one.1, &two.1, &three.1, &four.1]);
    }
}

/// Largest error of an angle after 0.2 s in steps of `dt` s.
fn swing_error(model: &Model, exact: &State, dt: f64) -> f64 {
    let (mut dynamics, mut state) = (Dynamics::new(model), start(model));
    for _ in 0..(0.2 / dt).round() as usize {
        assert!(dynamics.step(model, &mut state, &Input::default(), dt).converged);
        assert_follows(&state);
    }
    state.qpos.iter().zip(&exact.qpos).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

#[test]
fn a_coupled_finger_swings_as_the_reduced_equation() {
    let model = coupled(builder(None));
    let mut exact = start(&model);
    for _ in 0..200 {
        fourth_order(&model, &mut exact, 1e-3);
    }
    let errors = [2e-3, 1e-3, 5e-4].map(|dt| swing_error(&model, &exact, dt));
    let moved = exact.qpos.iter().zip(&start(&model).qpos).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(
        moved > 1.0 && errors[0] < 0.01 && errors[1] < 0.6 * errors[0] && errors[2] < 0.6 * errors[1],
        "{errors:?}"
    );
}

/// Lets a driven finger settle and returns the largest generalised force that is left in the coordinates that are free, N m, and
/// how often shapes touched in the end.
fn settle(model: &Model, targets: &[f64]) -> (f64, Vec<f64>, usize) {
    let (mut dynamics, mut state) = (Dynamics::new(model), model.reference_state());
    let input = Input { targets, ..Input::default() };
    for _ in 0..1500 {
        assert!(dynamics.step(model, &mut state, &input, 0.002).converged);
        assert_follows(&state);
    }
    assert!(state.qvel.iter().all(|speed| speed.abs() < 2e-4), "not settled: {state:?}");
    let mut mechanics = Mechanics::new(model);
    mechanics.update_equation(model, &state);
    let mut forces: Vec<f64> = mechanics.bias_force().iter().map(|bias| -bias).collect();
    for ((body, _), effort) in model.drives().iter().zip(dynamics.efforts()) {
        forces[model.bodies()[body.0].dof_start] += effort;
    }
    let mut touched = 0;
    for contact in dynamics.contacts() {
        touched += usize::from(contact.force.norm() > 0.1);
        for (shape, sign) in [(contact.shape_a, -1.0), (contact.shape_b, 1.0)] {
            let body = model.shapes()[shape.0].body;
            mechanics.add_force(model, body, &contact.position, &(contact.force * sign), &mut forces);
        }
    }
    let left = free_columns(model).iter().map(|column| dot(column, &forces).abs()).fold(0.0, f64::max);
    (left, state.qpos, touched)
}

fn strong() -> Option<Drive> {
    Some(Drive { stiffness: 60.0, damping: 6.0, effort_limit: 80.0, speed_limit: f64::INFINITY })
}

#[test]
fn contact_loads_a_follower_through_its_leader() {
    // The tip is pressed on a ball that is fixed.
    let targets = [0.0, 0.6, 0.1, 0.0, 0.0];
    let (left, free, touched) = settle(&coupled(builder(strong())), &targets);
    assert!(left < 1e-3 && touched == 0, "{left}, {touched}");
    let model = coupled(builder(strong()));
    let mut mechanics = Mechanics::new(&model);
    let settled = State { qpos: free.clone(), qvel: vec![0.0; model.nv()] };
    mechanics.update(&model, &settled);
    let at = mechanics.world_point(TIP, &Vector3::new(0.03, 0.0, 0.0));
    let mut with_ball = builder(strong());
    add_ball(&mut with_ball, TIP, [0.03, 0.0, 0.0], 0.01);
    add_ball(&mut with_ball, BodyId::WORLD, [at.x, at.y, at.z - 0.012], 0.01);
    let (left, pressed, touched) = settle(&coupled(with_ball), &targets);
    assert!(touched > 0 && (pressed[1] - free[1]).abs() > 1e-3, "{touched}, {} and {}", pressed[1], free[1]);
    assert!(left < 1e-3, "{left} N m are left");
}

#[test]
fn contact_within_a_finger_loads_the_leader_above_both_links() {
    let targets = [0.0, 0.6, 0.1, 0.0, 0.0];
    let (_, free, _) = settle(&coupled(builder(strong())), &targets);
    let model = coupled(builder(strong()));
    let mut mechanics = Mechanics::new(&model);
    mechanics.update(&model, &State { qpos: free.clone(), qvel: vec![0.0; model.nv()] });
    let tip = mechanics.world_point(TIP, &Vector3::new(0.03, 0.0, 0.0)) - Vector3::new(0.0, 0.0, 0.012);
    let at = mechanics.world_from_body(PEG).inverse() * nalgebra::Point3::from(tip);
    let mut with_balls = builder(strong());
    add_ball(&mut with_balls, TIP, [0.03, 0.0, 0.0], 0.01);
    add_ball(&mut with_balls, PEG, [at.x, at.y, at.z], 0.01);
    let (left, pressed, touched) = settle(&coupled(with_balls), &targets);
    assert!(touched > 0 && (pressed[1] - free[1]).abs() > 1e-4, "{touched}, {} and {}", pressed[1], free[1]);
    assert!(left < 1e-3, "{left} N m are left");
}

#[test]
fn a_restart_from_any_step_is_equal_to_the_bit() {
    let model = coupled(builder(strong()));
    let targets = [0.5, -0.4, 0.3, 0.2, -0.6];
    let input = Input { targets: &targets, ..Input::default() };
    let (mut dynamics, mut state) = (Dynamics::new(&model), start(&model));
    let mut middle = state.clone();
    for step in 0..100 {
        if step == 50 {
            middle = state.clone();
        }
        dynamics.step(&model, &mut state, &input, 0.005);
    }
    let mut other = Dynamics::new(&model);
    for _ in 50..100 {
        other.step(&model, &mut middle, &input, 0.005);
    }
    assert_eq!(state, middle);
}

#[test]
fn a_state_off_the_coupling_is_set_by_the_leader() {
    let model = coupled(builder(None));
    let (mut on, mut off) = (start(&model), start(&model));
    (off.qpos[3], off.qvel[4]) = (1.0, -3.0);
    for state in [&mut on, &mut off] {
        Dynamics::new(&model).step(&model, state, &Input::default(), 0.005);
    }
    assert_eq!(on, off);
}

#[test]
fn the_followers_limits_hold_the_leader() {
    let model = coupled(builder(strong()));
    let (_, settled, _) = settle(&model, &[0.0, 2.4, 0.0, 0.0, 0.0]);
    // The third link is at its limit of 2.5 rad where 1.6 q + 0.1 is.
    assert!((settled[1] - 1.5).abs() < 5e-3 && settled[3] < 2.505, "{settled:?}");
}

#[test]
fn couplings_that_cannot_hold_are_refused() {
    let [good, _] = COUPLINGS;
    let cases = [
        (Coupling { ratio: 0.0, ..good }, "ratio is 0"),
        (Coupling { ratio: f64::NAN, ..good }, "ratio is NaN"),
        (Coupling { offset: f64::INFINITY, ..good }, "offset is inf"),
        (Coupling { leader: PEG, ..good }, "a body above the follower"),
        (Coupling { leader: good.follower, ..good }, "a body above the follower"),
        (Coupling { leader: TIP, ..good }, "a body above the follower"),
        (Coupling { leader: BodyId::WORLD, ..good }, "must be hinges"),
        (Coupling { follower: BodyId(99), ..good }, "must be hinges"),
        (Coupling { follower: BodyId(3), ..good }, "stiffness 0"),
        (Coupling { offset: 9.0, ..good }, "no angle of the leader"),
    ];
    for (coupling, part) in cases {
        let error = builder(strong()).couple(coupling).unwrap_err().to_string();
        assert!(error.contains(part), "{coupling:?}: {error}");
    }
    let mut twice = builder(None);
    twice.couple(good).unwrap();
    assert!(twice.couple(good).unwrap_err().to_string().contains("already"));
    let chain = Coupling { follower: TIP, leader: good.follower, ..good };
    assert!(twice.couple(chain).unwrap_err().to_string().contains("cannot follow"));
}
