//! A robot that tumbles in empty space, where nothing adds or removes energy.

use std::sync::Arc;

use fiatlux_dynamics::{Dynamics, Input, Joint, Mechanics, Model, ModelBuilder, ModelError, State};
use fiatlux_robot::{GainSet, Robot};
use fiatlux_world::{PHYSICS_DT, Random, Scene, SceneConfig, SceneSpec, Stream};
use nalgebra::Vector3;

use super::FlightReport;
use crate::BenchError;

/// Speeds of every joint at the start, rad/s.
pub(super) const JOINT_SPEEDS: [f64; 2] = [15.0, 30.0];
/// Starts, and steps of 5 ms from each.
const STARTS: u64 = 16;
pub(super) const STEPS: usize = 20;
/// Largest distance of a joint from zero at the start, rad.
const POSTURE: f64 = 0.5;

/// Measures from starts in which every joint has the same speed with a random sign.
pub(super) fn measure(joint_speed: f64) -> Result<FlightReport, BenchError> {
    let model = robot_in_space()?;
    let (mut worst, mut mean) = (0.0_f64, 0.0);
    for mut state in starts(&model, joint_speed) {
        let (mut dynamics, mut mechanics) = (Dynamics::new(&model), Mechanics::new(&model));
        let before = kinetic_energy(&mut mechanics, &model, &state);
        let mut change = 0.0;
        for _ in 0..STEPS {
            dynamics.step(&model, &mut state, &Input::default(), PHYSICS_DT);
            change = kinetic_energy(&mut mechanics, &model, &state) / before - 1.0;
            // NaN counts as the worst change.
            worst = worst.max(if change.is_nan() { f64::INFINITY } else { change.abs() });
        }
        mean += change / STARTS as f64;
    }
    Ok(FlightReport { joint_speed, worst, mean })
}

/// The states that [`measure`] starts from.
pub(super) fn starts(model: &Model, joint_speed: f64) -> impl Iterator<Item = State> {
    (0..STARTS).map(move |start| {
        let mut random = Random::of_term(Stream::Trial, "flight", 0, start);
        let mut state = model.reference_state();
        state.qpos[7..].fill_with(|| random.uniform(-POSTURE, POSTURE));
        state.qvel[6..].fill_with(|| if random.unit() < 0.5 { -joint_speed } else { joint_speed });
        state
    })
}

/// The robot without drives, joint limits, shapes and gravity.
pub(super) fn robot_in_space() -> Result<Model, BenchError> {
    let robot = Arc::new(Robot::benchmark().map_err(|e| BenchError::Scene(e.into()))?);
    let spec = SceneSpec::floor(robot.gains(GainSet::Fiatlux));
    let scene = Scene::build(&SceneConfig::default(), robot, spec).map_err(|e| BenchError::Scene(e.into()))?;
    let build = || -> Result<Model, ModelError> {
        let mut builder = ModelBuilder::new();
        builder.set_gravity(Vector3::zeros());
        for body in &scene.model.bodies()[1..] {
            let mut spec = body.spec.clone();
            if let Joint::Hinge(hinge) = &mut spec.joint {
                (hinge.drive, hinge.lower, hinge.upper) = (None, f64::NEG_INFINITY, f64::INFINITY);
            }
            builder.add_body(spec)?;
        }
        builder.build()
    };
    build().map_err(|e| BenchError::Scene(e.into()))
}

fn kinetic_energy(mechanics: &mut Mechanics, model: &Model, state: &State) -> f64 {
    let mut mass_matrix = vec![0.0; model.nv() * model.nv()];
    mechanics.update_equation(model, state);
    mechanics.mass_matrix(model, &mut mass_matrix);
    let momentum =
        mass_matrix.chunks(model.nv()).map(|row| row.iter().zip(&state.qvel).map(|(m, v)| m * v).sum::<f64>());
    0.5 * momentum.zip(&state.qvel).map(|(p, v)| p * v).sum::<f64>()
}
