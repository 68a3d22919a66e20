//! Resistance to rolling and turning, against closed forms.

use fiatlux_dynamics::*;
use nalgebra::{Isometry3, Matrix3, UnitQuaternion, Vector3};

const DT: f64 = 0.005;
const RADIUS: f64 = 0.04;
const GRAVITY: f64 = 9.81;
const ROLLING: f64 = 5e-4;
const TORSION: f64 = 2e-4;
/// A solid ball's moment of inertia over that of its mass at its radius.
const SHARE: f64 = 0.4;

/// A ball of 35 g on a half-space tilted about y, which the ball has rolling and torsional friction with.
fn ball_on_slope(slope: f64, priority: i32) -> (Model, State) {
    let mass = 0.035;
    let mut builder = ModelBuilder::new();
    let tilt = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), slope);
    let start = Isometry3::from_parts((tilt * Vector3::new(0.0, 0.0, RADIUS)).into(), UnitQuaternion::identity());
    let ball = builder
        .add_body(BodySpec {
            name: "ball".into(),
            parent: BodyId::WORLD,
            parent_from_body: start,
            joint: Joint::Free,
            mass,
            com: Vector3::zeros(),
            inertia: Matrix3::identity() * (SHARE * mass * RADIUS * RADIUS),
        })
        .unwrap();
    let round = Material { friction: 1.0, torsion: TORSION, rolling: ROLLING, priority: 0 };
    let shapes = [
        ("ball", ball, Isometry3::identity(), Geometry::Sphere { radius: RADIUS }, round),
        (
            "ground",
            BodyId::WORLD,
            Isometry3::from_parts(Vector3::zeros().into(), tilt),
            Geometry::HalfSpace,
            Material::new(1.0, priority),
        ),
    ];
    for (index, (name, body, body_from_shape, geometry, material)) in shapes.into_iter().enumerate() {
        let (name, cull_group) = (name.into(), index as u16);
        builder.add_shape(ShapeSpec { name, body, body_from_shape, geometry, material, cull_group, label: 0 }).unwrap();
    }
    let model = builder.build().unwrap();
    let state = model.reference_state();
    (model, state)
}

fn run(model: &Model, state: &mut State, seconds: f64) {
    let mut dynamics = Dynamics::new(model);
    for _ in 0..(seconds / DT).round() as usize {
        assert!(dynamics.step(model, state, &Input::default(), DT).converged);
    }
}

/// Acceleration of a ball that rolls down a slope, or along a floor where it is negative.
fn rolling_acceleration(slope: f64) -> f64 {
    GRAVITY * (slope.sin() - ROLLING / RADIUS * slope.cos()) / (1.0 + SHARE)
}

#[test]
fn a_rolling_ball_comes_to_rest_after_its_closed_form() {
    let (model, mut state) = ball_on_slope(0.0, 0);
    let speed = 0.2;
    (state.qvel[0], state.qvel[4]) = (speed, speed / RADIUS);
    let slowing = -rolling_acceleration(0.0);
    run(&model, &mut state, 1.0);
    let expected = speed - slowing;
    assert!((state.qvel[0] / expected - 1.0).abs() < 0.02, "{} m/s after 1 s, closed form {expected}", state.qvel[0]);
    run(&model, &mut state, speed / slowing);
    let way = 0.5 * speed * speed / slowing;
    assert_eq!(state.qvel, [0.0; 6], "it lies");
    assert!((state.qpos[0] / way - 1.0).abs() < 0.02, "{} m, closed form {way}", state.qpos[0]);
}

#[test]
fn a_ball_holds_below_the_lever_over_its_radius_and_rolls_above() {
    let limit = (ROLLING / RADIUS).atan();
    let (model, mut state) = ball_on_slope(0.8 * limit, 0);
    let start = state.clone();
    run(&model, &mut state, 10.0);
    let crept = (0..3).map(|k| (state.qpos[k] - start.qpos[k]).powi(2)).sum::<f64>().sqrt();
    assert!(crept < 1e-4, "crept {crept} m in 10 s");
    for slope in [1.2 * limit, 3.0 * limit, 0.3] {
        let (model, mut state) = ball_on_slope(slope, 0);
        run(&model, &mut state, 0.5);
        let (speed, expected) =
            (state.qvel[..3].iter().map(|v| v * v).sum::<f64>().sqrt(), 0.5 * rolling_acceleration(slope));
        assert!((speed / expected - 1.0).abs() < 0.05, "{speed} m/s at {slope} rad, closed form {expected}");
    }
}

#[test]
fn a_ball_that_spins_upright_slows_by_its_torsion() {
    let (model, mut state) = ball_on_slope(0.0, 0);
    state.qvel[5] = 10.0;
    run(&model, &mut state, 0.5);
    let expected = 10.0 - TORSION * GRAVITY / (SHARE * RADIUS * RADIUS) * 0.5;
    assert!((state.qvel[5] / expected - 1.0).abs() < 0.01, "{} rad/s, closed form {expected}", state.qvel[5]);
}

#[test]
fn a_surface_of_higher_priority_without_resistance_lets_it_roll() {
    let (model, mut state) = ball_on_slope(0.0, 1);
    (state.qvel[0], state.qvel[4]) = (0.2, 0.2 / RADIUS);
    run(&model, &mut state, 2.0);
    assert!((state.qvel[0] - 0.2).abs() < 1e-4, "{} m/s", state.qvel[0]);
}
