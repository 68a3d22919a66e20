//! One episode of `ladder`, without a server.

use std::error::Error;
use std::sync::Arc;

use fiatlux_client::{Command, Policy};
use fiatlux_policies::Ladder;
use fiatlux_proto::v3::{Observation, SessionInfo, TaskInfo};
use fiatlux_render::Lighting;
use fiatlux_robot::{GainSet, Robot};
use fiatlux_rules::{CONTROL_DT, Cause, Causes, Task, errand, measure};
use fiatlux_sensing::{NoiseSeed, Sensor, SensorSuite, Sensors, Setup, View};
use fiatlux_wire::{footprint_messages, joint_messages};
use fiatlux_world::{ACTION_SCALE, Episode, EpisodeSpec, Scene, SceneConfig, ShapeOwner};

const SENSORS: Sensors = Sensors::of(&[Sensor::Proprioception, Sensor::LastAction, Sensor::Privileged]);

/// The end of an episode.
#[derive(Debug)]
pub struct Played {
    pub cause: Cause,
    pub seconds: f64,
    pub phase: String,
    /// Distance of the ladder's top point from the fixture, seen from above, at the start and at the end, m.
    pub distance: [f64; 2],
    /// Largest tilt of the ladder, rad.
    pub tilt: f64,
    /// Largest height of a foot of the ladder at the end, m.
    pub feet: f64,
    /// Largest force on anything but robot, ladder and floor at the ends of control steps, N, and what was pressed.
    pub touched: (f64, &'static str),
}

/// Forces of robot and ladder on everything but the floor at the end of a control step, N.
pub fn touched(episode: &Episode) -> (f64, &'static str) {
    let scene = episode.scene();
    let is_other = |owner: ShapeOwner| {
        let carries = matches!(owner, ShapeOwner::Robot(_)) || owner == ShapeOwner::LADDER;
        !(carries || owner == ShapeOwner::Floor)
    };
    let mut largest = (0.0, "nothing");
    for contact in episode.world().dynamics().contacts() {
        let owners = [contact.shape_a, contact.shape_b].map(|shape| scene.owner(shape));
        let carries = |owner: ShapeOwner| !is_other(owner) && owner != ShapeOwner::Floor;
        let other = owners.into_iter().find(|owner| is_other(*owner));
        if let Some(other) = other.filter(|_| owners.into_iter().any(carries))
            && contact.force.norm() > largest.0
        {
            largest = (contact.force.norm(), other.name());
        }
    }
    largest
}

/// Distance of the ladder's top point from the fixture, seen from above, m.
pub fn distance(episode: &Episode) -> f64 {
    let (row, scene) = (episode.row(), episode.scene());
    let fixture = row.body(errand::FIXTURE).pose.translation.vector;
    measure::horizontal_distance(&scene.geometry().ladder_top(row), &fixture)
}

/// An episode of S01, and what the robot senses.
pub struct Game {
    pub episode: Episode,
    pub info: SessionInfo,
    suite: SensorSuite,
}

impl Game {
    /// Starts the first episode of a room; with other causes that end it, in place of the task's.
    pub fn start(seed: u64, end_on: Option<Causes>) -> Result<Self, Box<dyn Error>> {
        let robot = Arc::new(Robot::benchmark()?);
        let gains = robot.gains(GainSet::default());
        let spec = EpisodeSpec { end_on, ..EpisodeSpec::new(Task::S01, seed, 0) };
        let scene = Arc::new(Scene::build(&SceneConfig::default(), Arc::clone(&robot), spec.scene(gains.clone()))?);
        let episode = Episode::start(Arc::clone(&scene), &spec)?;
        let mut suite = SensorSuite::new(SENSORS, Setup::new(&scene, Task::S01));
        suite.begin(&scene, NoiseSeed::of(&spec), || unreachable!("no camera"), Lighting::default())?;
        let info = SessionInfo {
            task: Some(TaskInfo { task: "S01".into(), ..TaskInfo::default() }),
            joints: joint_messages(&robot, &gains),
            footprints: footprint_messages(&scene),
            action_scale: ACTION_SCALE,
            control_dt: CONTROL_DT,
            ..SessionInfo::default()
        };
        Ok(Self { episode, info, suite })
    }

    /// The robot's sensors now. Every call draws noise anew.
    pub fn observe(&mut self) -> Result<Observation, Box<dyn Error>> {
        Ok(self.suite.observe(&View::of(&self.episode), SENSORS)?)
    }

    /// A control step with a policy's answer to an observation; the next observation.
    pub fn step(&mut self, policy: &mut dyn Policy, seen: &Observation) -> Result<Observation, Box<dyn Error>> {
        let Command::JointTarget(targets) = policy.act(seen)? else { return Err("no targets".into()) };
        let action = self.episode.action_for(&targets);
        self.episode.step(&action)?;
        self.observe()
    }
}

/// Plays the first episode of a room.
pub fn play(mut ladder: Ladder, seed: u64, mut watch: impl FnMut(&Episode, &str)) -> Result<Played, Box<dyn Error>> {
    let mut game = Game::start(seed, None)?;
    let mut seen = game.observe()?;
    ladder.reset(&game.info, &seen)?;
    let first = distance(&game.episode);
    let mut tilt = 0.0_f64;
    let mut pressed = (0.0, "nothing");
    loop {
        let (episode, phase) = (&game.episode, ladder.phase().unwrap_or_default());
        tilt = tilt.max(measure::tilt(&episode.row().things[errand::LADDER].pose));
        let now = touched(episode);
        pressed = if now.0 > pressed.0 { now } else { pressed };
        watch(episode, &phase);
        if let Some(end) = episode.end() {
            let feet = episode.scene().geometry().ladder_feet(episode.row()).into_iter().fold(0.0, f64::max);
            let seconds = end.step as f64 * CONTROL_DT;
            let distance = [first, distance(episode)];
            return Ok(Played { cause: end.cause(), seconds, phase, distance, tilt, feet, touched: pressed });
        }
        seen = game.step(&mut ladder, &seen)?;
    }
}
