//! Cost of fingers, ladder, furniture and bulbs in a step of a robot that touches none of them.

use std::sync::Arc;
use std::time::Instant;

use fiatlux_dynamics::{Dynamics, Input, State};
use fiatlux_robot::{GainSet, Robot};
use fiatlux_world::{PHYSICS_DT, Scene, SceneConfig, SceneKind, SceneParts, SceneSpec};

use super::case::stand_old_bulb_on_bench;
use super::{BenchError, RoomReport};

/// Stiffness and damping of the ankles, in units of their own, with which the robot stands without a controller, and how far
/// their pitch targets are from q0, rad: the lever of the weight before the ankles needs as much.
const FIRM_ANKLES: f64 = 8.0;
const ANKLE_LEAN: f64 = 0.06;
/// Amplitude, rad, and frequency, Hz, of the waving arms.
const WAVE: f64 = 0.3;
const WAVE_RATE: f64 = 1.0;
/// Physics steps to settle before the first measurement, and physics steps in a measurement. Of the measurements of a scene,
/// so many, the best counts.
const SETTLE: usize = 400;
const STEPS: usize = 400;
const ROUNDS: usize = 20;

/// A robot that stands and waves its arms: the bare one on a floor, and the one with fingers in the whole room.
pub(crate) fn run() -> Result<RoomReport, BenchError> {
    fiatlux_cli::report("bench: the whole room against a bare robot on a floor");
    let mut bare = Waver::new("g1_bare", SceneParts::FLOOR)?;
    let mut room = Waver::new(Robot::NAMES[0], SceneKind::CoupledLadder.into())?;
    let (mut bare_us, mut room_us) = (f64::INFINITY, f64::INFINITY);
    for _ in 0..ROUNDS {
        bare_us = bare_us.min(bare.measure());
        room_us = room_us.min(room.measure());
    }
    Ok(RoomReport { bare_us, room_us, ratio: room_us / bare_us })
}

struct Waver {
    scene: Scene,
    dynamics: Dynamics,
    state: State,
    /// Targets of a robot that does not wave, by drive, rad, and the drives that wave.
    rest: Vec<f64>,
    arms: Vec<usize>,
    targets: Vec<f64>,
    step: usize,
}

impl Waver {
    fn new(robot: &str, parts: SceneParts) -> Result<Self, BenchError> {
        let robot = Arc::new(Robot::by_name(robot).map_err(|e| BenchError::Scene(e.into()))?);
        let mut gains = robot.gains(GainSet::Fiatlux);
        let ankles = (0..robot.joints().len()).filter(|&i| robot.joints()[i].name.contains("ankle"));
        gains.scale(ankles, FIRM_ANKLES);
        let spec = SceneSpec::new(parts, 0, gains);
        let scene = Scene::build(&SceneConfig::default(), robot, spec).map_err(|e| BenchError::Scene(e.into()))?;
        let mut state = scene.model.reference_state();
        let world_from_pelvis = scene.layout.robot.world_from_place(scene.robot.standing_height());
        state.set_pose(&scene.model, scene.robot_ids.root, &world_from_pelvis);
        for (ids, &angle) in scene.robot_ids.joints.iter().zip(scene.robot.q0()) {
            state.qpos[ids.qpos] = angle;
        }
        stand_old_bulb_on_bench(&scene, &mut state);
        let (mut rest, mut arms) = (vec![0.0; scene.robot.joints().len()], Vec::new());
        for ((ids, joint), q0) in scene.robot_ids.joints.iter().zip(scene.robot.joints()).zip(scene.robot.q0()) {
            let lean = if joint.name.ends_with("ankle_pitch_joint") { ANKLE_LEAN } else { 0.0 };
            rest[ids.drive] = q0 + lean;
            if ["shoulder", "elbow", "wrist"].iter().any(|part| joint.name.contains(part)) {
                arms.push(ids.drive);
            }
        }
        let (dynamics, targets) = (Dynamics::new(&scene.model), rest.clone());
        let mut waver = Self { scene, dynamics, state, rest, arms, targets, step: 0 };
        waver.play(SETTLE);
        Ok(waver)
    }

    /// Mean time of a step, us.
    fn measure(&mut self) -> f64 {
        let start = Instant::now();
        self.play(STEPS);
        start.elapsed().as_secs_f64() * 1e6 / STEPS as f64
    }

    fn play(&mut self, steps: usize) {
        for _ in 0..steps {
            let phase = std::f64::consts::TAU * WAVE_RATE * PHYSICS_DT * self.step as f64;
            let wave = WAVE * libm::sin(phase);
            for &drive in &self.arms {
                self.targets[drive] = self.rest[drive] + wave;
            }
            let input = Input { targets: &self.targets, ..Input::default() };
            self.dynamics.step(&self.scene.model, &mut self.state, &input, PHYSICS_DT);
            self.step += 1;
        }
    }
}
