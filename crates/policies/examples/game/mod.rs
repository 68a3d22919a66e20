//! An episode without a server, the same to the last bit as in a session: what the examples of the policies share.
#![allow(dead_code)] // Each of them uses a part.

use std::error::Error;
use std::sync::Arc;

use fiatlux_client::{Command, Policy};
use fiatlux_dynamics::Variation;
use fiatlux_play::Play;
use fiatlux_proto::v3::{Observation, SessionInfo};
use fiatlux_robot::{GainSet, Robot};
use fiatlux_rules::{CONTROL_DT, Task, Verdict};
use fiatlux_sensing::{Sensor, SensorSuite, Sensors, Setup};
use fiatlux_wire::session_terms;
use fiatlux_world::{AppliedWrench, Episode, EpisodeSpec, Push, Scene, SceneConfig, StartOptions, World, start_drawn};
use nalgebra::Vector3;

const SENSORS: Sensors =
    Sensors::of(&[Sensor::Proprioception, Sensor::HandContact, Sensor::LastAction, Sensor::Privileged]);

/// An episode's start, and by which rules it is judged.
pub struct Start {
    pub robot: Arc<Robot>,
    /// Its task is the one from whose start state it begins.
    pub spec: EpisodeSpec,
    /// Task of the session and of the judge.
    pub task: Task,
    /// Friction of the hands, in place of the drawn one.
    pub hand_friction: Option<f64>,
    /// Control steps until an action has an effect.
    pub delay: usize,
    /// The scene's numbers.
    pub config: SceneConfig,
}

impl Start {
    /// The first episode of a room, as in the benchmark.
    pub fn of(task: Task, seed: u64) -> Result<Self, Box<dyn Error>> {
        Ok(Self {
            robot: Arc::new(Robot::benchmark()?),
            spec: EpisodeSpec::new(task, seed, 0),
            task,
            hand_friction: None,
            delay: 0,
            config: SceneConfig::default(),
        })
    }
}

/// An episode under the strict rules, and what the robot senses.
#[derive(Clone)]
pub struct Game {
    pub info: SessionInfo,
    /// Wrenches that are held over every step.
    pub wrenches: Vec<AppliedWrench>,
    play: Play,
}

impl Game {
    pub fn start(start: Start) -> Result<Self, Box<dyn Error>> {
        Self::start_varied(start, |_| Variation::default())
    }

    /// Starts with what varies in the world, which is told of its scene.
    pub fn start_varied(start: Start, varied: impl FnOnce(&Scene) -> Variation) -> Result<Self, Box<dyn Error>> {
        let Start { robot, spec, task, hand_friction, delay, config } = start;
        let mut of_scene = spec.scene(robot.gains(GainSet::default()));
        of_scene.hand_friction = hand_friction.or(of_scene.hand_friction);
        let scene = Arc::new(Scene::build(&config, robot, of_scene)?);
        let drawn = StartOptions { seed: Some(spec.seed), ..StartOptions::default() };
        let (mut world, offset) = start_drawn(Arc::clone(&scene), spec.task, 0, &drawn)?;
        world.set_variation(&varied(&scene))?;
        let episode = Episode::in_world(world, offset, &EpisodeSpec { task, ..spec });
        let play = Play::start(episode, SensorSuite::new(SENSORS, Setup::new(&scene, task)), delay)?;
        Ok(Self { info: session_terms(task, &scene), wrenches: Vec::new(), play })
    }

    pub fn world(&self) -> &World {
        self.play.episode().world()
    }

    /// The verdict on what was so far.
    pub fn verdict(&self) -> &Verdict {
        self.play.episode().verdict()
    }

    /// Time since the start, s.
    pub fn seconds(&self) -> f64 {
        self.world().row().step as f64 * CONTROL_DT
    }

    /// The robot's sensors now.
    pub fn observe(&mut self) -> Result<Observation, Box<dyn Error>> {
        Ok(self.play.observe(SENSORS)?)
    }

    /// A control step with a policy's answer to an observation; the next observation.
    pub fn step(
        &mut self,
        policy: &mut dyn Policy,
        seen: &Observation,
        push: Option<Push>,
    ) -> Result<Observation, Box<dyn Error>> {
        let command = policy.act(seen)?;
        self.go_on(&command, push)
    }

    /// A control step with a command; the next observation.
    pub fn go_on(&mut self, command: &Command, push: Option<Push>) -> Result<Observation, Box<dyn Error>> {
        self.play.step_under(command, push, &self.wrenches)?;
        self.observe()
    }
}

/// The golden angle, rad: multiples of it spread directions over the rooms.
pub const SPREAD: f64 = 2.399_963;

/// A push of the whole robot to a side, m/s and rad.
pub fn push_towards(angle: f64, speed: f64) -> Push {
    Push { linear: speed * Vector3::new(angle.cos(), angle.sin(), 0.0), angular: Vector3::zeros() }
}
