//! The worlds that are measured, and how long they take.

use std::sync::Arc;
use std::time::{Duration, Instant};

use fiatlux_batch::{
    Bank, Batch, BatchConfig, Control, Field, Outcome, Outputs, Spec, Task, TaskError, Walking, WalkingOptions,
};
use fiatlux_robot::{GainSet, Robot};
use fiatlux_rules::Row;
use fiatlux_sensing::{NoiseSeed, Observer, Proprioception};
use fiatlux_world::{ACTION_SCALE, Light, Random, Scene, SceneConfig, SceneSpec, World};

use crate::BenchError;

/// Control steps of each world from the start of its episode.
const STEPS: usize = 50;

/// Cases to measure and to compare with.
#[derive(Debug, Clone)]
pub struct BatchOptions {
    pub worlds: usize,
    /// Number of threads, and of processes to compare them with.
    pub threads: usize,
    /// Rounds of threads against processes.
    pub rounds: usize,
    pub seconds: f64,
}

pub(super) struct Running {
    batch: Batch,
    outputs: Outputs,
    actions: Vec<f64>,
}

impl Running {
    pub fn new(batch: Batch) -> Self {
        let actions = vec![0.0; batch.worlds() * batch.spec().actions.len()];
        Self { outputs: Outputs::new(&batch), batch, actions }
    }

    pub fn reset(&mut self) -> Result<(), BenchError> {
        self.batch.reset_with_seed(0, &mut self.outputs.observation).map_err(failed)
    }

    pub fn step(&mut self) -> Result<(), BenchError> {
        self.batch.step(&self.actions, &mut self.outputs.buffers()).map_err(failed)
    }

    pub fn rate(&mut self, budget: Duration) -> Result<f64, BenchError> {
        rate(budget, self.batch.worlds(), self, Self::reset, Self::step)
    }
}

/// Control steps per second. Every case is stepped repeatedly from the start of an episode: a long episode comes to
/// rest, and its steps become cheaper.
pub(super) fn rate<T>(
    budget: Duration,
    worlds: usize,
    stepped: &mut T,
    begin: impl Fn(&mut T) -> Result<(), BenchError>,
    step: impl Fn(&mut T) -> Result<(), BenchError>,
) -> Result<f64, BenchError> {
    let (mut spent, mut steps) = (Duration::ZERO, 0);
    while spent < budget {
        begin(stepped)?;
        let begun = Instant::now();
        (0..STEPS).try_for_each(|_| step(stepped))?;
        spent += begun.elapsed();
        steps += STEPS * worlds;
    }
    Ok(steps as f64 / spent.as_secs_f64())
}

pub(super) fn standing_batch(
    world: &World,
    targets: &[f64],
    worlds: usize,
    threads: usize,
    senses: bool,
) -> Result<Batch, BenchError> {
    let mut bank = Bank::standing(Arc::clone(world.scene()));
    bank.starts[0].row = world.row().clone();
    let config = BatchConfig { worlds, threads, ..BatchConfig::new(vec![bank]) };
    Batch::new(config, &Hold::new(world.scene(), targets, senses)).map_err(failed)
}

pub(super) fn walking_batch(worlds: usize, threads: usize) -> Result<Batch, BenchError> {
    let robot = Arc::new(Robot::by_name("g1_bare").map_err(failed)?);
    let spec = SceneSpec::floor(robot.gains(GainSet::Fiatlux));
    let scene = Arc::new(Scene::build(&SceneConfig::default(), robot, spec).map_err(failed)?);
    let task = Walking::new(&scene, WalkingOptions::default()).map_err(BenchError::Scene)?;
    let config = BatchConfig { worlds, threads, ..BatchConfig::new(vec![Bank::standing(scene)]) };
    Batch::new(config, &task).map_err(failed)
}

pub(super) fn failed(error: impl std::error::Error + Send + Sync + 'static) -> BenchError {
    BenchError::Scene(Box::new(error))
}

/// Holds joint targets constant.
#[derive(Clone)]
struct Hold {
    spec: Spec,
    targets: Vec<f64>,
    senses: Option<(Observer, Proprioception)>,
}

impl Hold {
    fn new(scene: &Scene, targets: &[f64], senses: bool) -> Self {
        let length = 10 + 2 * targets.len();
        let observation = senses.then(|| Field::new("proprioception", &[length]));
        Self {
            spec: Spec {
                actions: vec![],
                action_range: vec![],
                horizon_steps: u64::MAX,
                action_limit: 0.0,
                observation: observation.into_iter().collect(),
                rewards: vec![],
                reward_weights: vec![],
            },
            targets: targets.into(),
            senses: senses
                .then(|| (Observer::new(scene.robot.q0().to_vec(), None), Proprioception::zeros(targets.len()))),
        }
    }
}

impl Task for Hold {
    fn spec(&self) -> &Spec {
        &self.spec
    }

    fn begin(&mut self, _: &World, _: &Light, _: &mut Random) -> Result<(), TaskError> {
        if let Some((observer, _)) = &mut self.senses {
            observer.restart(Some(NoiseSeed { seed: 0, episode: 0 }));
        }
        Ok(())
    }

    fn command(&mut self, scene: &Scene, _: &Row, _: &[f64], _: &mut Random, control: &mut Control) {
        control.joint_target.copy_from_slice(&self.targets);
        let places = control.action.iter_mut().zip(&self.targets).zip(scene.robot.q0());
        places.for_each(|((place, target), q0)| *place = (target - q0) / ACTION_SCALE);
    }

    fn judge(&mut self, _: &World, _: &mut Random, _: &mut [f32]) -> Outcome {
        Outcome::Continues
    }

    fn observe(&mut self, world: &World, observation: &mut [f32]) -> Result<(), TaskError> {
        if let Some((observer, sensed)) = &mut self.senses {
            observer.observe(world.row(), sensed);
            let body = sensed.base_angular_velocity.iter().chain(&sensed.projected_gravity);
            let body = body.chain(&sensed.base_linear_velocity).chain([&sensed.base_height]);
            let numbers = body.chain(&sensed.joint_position).chain(&sensed.joint_velocity);
            observation.iter_mut().zip(numbers).for_each(|(place, number)| *place = *number as f32);
        }
        Ok(())
    }

    fn settings(&self) -> Vec<(&'static str, String)> {
        vec![("task", "hold".into())]
    }
}
