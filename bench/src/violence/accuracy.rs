//! Compares the engine at its step of 5 ms with itself at 0.25 ms.

use fiatlux_dynamics::{Dynamics, Input, State};
use fiatlux_world::{PHYSICS_DT, Random, SUBSTEPS, Scene, Stream};

use super::AccuracyReport;
use super::trial::{Pattern, Trials};
use crate::BenchError;

/// Number of fine steps in a step of 5 ms.
pub(super) const FINE: usize = 20;
/// Control steps after which both are compared: 0.1, 0.2, 0.5 and 1 s.
pub(super) const AT: [usize; 4] = [5, 10, 25, 50];
/// Number of runs for each pattern, over the tasks in turn; fewer if fewer are requested.
pub(super) const RUNS: u64 = 28;
pub(super) const PATTERNS: [Pattern; 3] = [Pattern::Boxes(0.2), Pattern::Boxes(1.0), Pattern::Limits];

/// Measures from the tasks' start states. The socket's hold is not part of the engine, so seated bulbs fall here.
pub(super) fn measure(trials: &Trials, runs: u64) -> Result<Vec<AccuracyReport>, BenchError> {
    PATTERNS.into_iter().map(|pattern| measure_pattern(trials, pattern, runs.clamp(1, RUNS))).collect()
}

fn measure_pattern(trials: &Trials, pattern: Pattern, runs: u64) -> Result<AccuracyReport, BenchError> {
    let name = pattern.name();
    fiatlux_cli::report(format!("bench: {name}, against a step of {} ms", 1e3 * PHYSICS_DT / FINE as f64));
    let mut distances: [Vec<(f64, f64)>; 4] = Default::default();
    for run in 0..runs {
        let world = trials.start(run)?;
        let scene = world.scene();
        let targets = targets(scene, pattern, run);
        let roll = |parts: usize| roll(scene, world.state(), &targets, parts);
        for (all, (coarse, fine)) in distances.iter_mut().zip(roll(1).iter().zip(&roll(FINE))) {
            all.push(distance(scene, coarse, fine));
        }
    }
    let errors = distances.map(|mut all| {
        let mut median = |of: fn(&(f64, f64)) -> f64| {
            all.sort_by(|a, b| of(a).total_cmp(&of(b)));
            of(&all[all.len() / 2])
        };
        (median(|distance| distance.0), median(|distance| distance.1))
    });
    Ok(AccuracyReport { name, errors })
}

/// Targets of each control step of a run, rad, in the order of the model's drives.
pub(super) fn targets(scene: &Scene, pattern: Pattern, run: u64) -> Vec<Vec<f64>> {
    let mut random = Random::of_term(Stream::Trial, "accuracy", run, 0);
    let mut targets = vec![0.0; scene.robot.joints().len()];
    let draw = |step| {
        pattern.draw(&scene.robot, step, &mut random, &mut targets);
        driven(scene, &targets)
    };
    (0..AT[3]).map(draw).collect()
}

/// Reorders targets from the public joint order to that of the model's drives, within the joints' limits.
pub(super) fn driven(scene: &Scene, targets: &[f64]) -> Vec<f64> {
    let mut driven = vec![0.0; targets.len()];
    for ((ids, joint), target) in scene.robot_ids.joints.iter().zip(scene.robot.joints()).zip(targets) {
        driven[ids.drive] = target.clamp(joint.lower, joint.upper);
    }
    driven
}

/// States of a run at the times of [`AT`], in steps of 5 ms divided by `parts`.
pub(super) fn roll(scene: &Scene, start: &State, targets: &[Vec<f64>], parts: usize) -> Vec<State> {
    let (mut state, mut dynamics) = (start.clone(), Dynamics::new(&scene.model));
    let mut states = Vec::new();
    for (step, targets) in targets.iter().enumerate() {
        let input = Input { targets, ..Input::default() };
        for _ in 0..SUBSTEPS * parts {
            dynamics.step(&scene.model, &mut state, &input, PHYSICS_DT / parts as f64);
        }
        if AT.contains(&(step + 1)) {
            states.push(state.clone());
        }
    }
    states
}

/// Distance of the pelvis, m, and of the joints (root mean square), rad.
fn distance(scene: &Scene, a: &State, b: &State) -> (f64, f64) {
    let square = |index: usize| (a.qpos[index] - b.qpos[index]).powi(2);
    let root = scene.robot_ids.root_qpos;
    let joints = &scene.robot_ids.joints;
    let pelvis = (root..root + 3).map(square).sum::<f64>();
    let mean = joints.iter().map(|ids| square(ids.qpos)).sum::<f64>() / joints.len() as f64;
    (libm::sqrt(pelvis), libm::sqrt(mean))
}
