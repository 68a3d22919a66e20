//! One episode of `ladder`, without a server.

use std::error::Error;
use std::sync::Arc;

use fiatlux_client::{Command, Policy};
use fiatlux_policies::Ladder;
use fiatlux_proto::v3::{Observation, SessionInfo, TaskInfo};
use fiatlux_render::Lighting;
use fiatlux_robot::{GainSet, Robot};
use fiatlux_rules::{
    CONTROL_DT, Cause, Causes, Judge, JudgeOptions, Protocol, Task, Thresholds, Verdict, errand, measure,
};
use fiatlux_sensing::{NoiseSeed, Sensor, SensorSuite, Sensors, Setup, View};
use fiatlux_wire::{footprint_messages, joint_messages};
use fiatlux_world::{
    ACTION_SCALE, ControlInput, EpisodeSpec, Push, Scene, SceneConfig, ShapeOwner, StartOptions, World, start_drawn,
};
use nalgebra::Vector3;

const SENSORS: Sensors = Sensors::of(&[Sensor::Proprioception, Sensor::LastAction, Sensor::Privileged]);

/// Control steps from the first entry into a phase to a push.
const UNTIL_PUSH: u64 = 100;
/// The golden angle spreads directions over the rooms.
const SPREAD: f64 = 2.399_963;

/// Differences of an episode from the benchmark's.
#[derive(Debug, Clone, Default)]
pub struct Changes {
    /// Height of the ladder, as a factor.
    pub height: Option<f64>,
    /// A push of the whole robot, m/s, 2 s after it first comes into a phase; in each room in another direction.
    pub push: Option<(f64, String)>,
    /// Causes that end it, in place of the task's.
    pub end_on: Option<Causes>,
}

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
    /// Depth of the deepest contact in all physics steps, m.
    #[allow(dead_code)]
    pub penetration: f64,
}

/// Forces of robot and ladder on everything but the floor at the end of a control step, N.
pub fn touched(world: &World) -> (f64, &'static str) {
    let scene = world.scene();
    let is_other = |owner: ShapeOwner| {
        let carries = matches!(owner, ShapeOwner::Robot(_)) || owner == ShapeOwner::LADDER;
        !(carries || owner == ShapeOwner::Floor)
    };
    let mut largest = (0.0, "nothing");
    for contact in world.dynamics().contacts() {
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
pub fn distance(world: &World) -> f64 {
    let (row, scene) = (world.row(), world.scene());
    let fixture = row.body(errand::FIXTURE).pose.translation.vector;
    measure::horizontal_distance(&scene.geometry().ladder_top(row), &fixture)
}

/// An episode of S01, and what the robot senses.
pub struct Game {
    pub world: World,
    pub info: SessionInfo,
    judge: Judge,
    suite: SensorSuite,
    push: Option<Push>,
    /// Phase after which it is pushed, and when.
    pushed: (String, Option<u64>),
}

impl Game {
    /// Starts the first episode of a room.
    pub fn start(seed: u64, changes: &Changes) -> Result<Self, Box<dyn Error>> {
        let robot = Arc::new(Robot::benchmark()?);
        let gains = robot.gains(GainSet::default());
        let mut spec = EpisodeSpec::new(Task::S01, seed, 0);
        spec.scale.ladder[2] = changes.height.unwrap_or(spec.scale.ladder[2]);
        let scene = Arc::new(Scene::build(&SceneConfig::default(), Arc::clone(&robot), spec.scene(gains.clone()))?);
        let options = StartOptions { seed: Some(seed), ..StartOptions::default() };
        let (world, _) = start_drawn(Arc::clone(&scene), Task::S01, 0, &options)?;
        let options = JudgeOptions { end_on: changes.end_on, ..JudgeOptions::default() };
        let mut judge = Judge::new(Protocol::Strict, Task::S01, Thresholds::default(), scene.geometry(), options);
        judge.start(world.row());
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
        let angle = SPREAD * seed as f64;
        let push = changes.push.as_ref().map(|(speed, _)| Push {
            linear: *speed * Vector3::new(angle.cos(), angle.sin(), 0.0),
            angular: Vector3::zeros(),
        });
        let phase = changes.push.as_ref().map(|(_, phase)| phase.clone()).unwrap_or_default();
        Ok(Self { world, info, judge, suite, push, pushed: (phase, None) })
    }

    /// The verdict on what was so far.
    pub fn verdict(&self) -> &Verdict {
        self.judge.verdict()
    }

    /// The robot's sensors now. Every call draws noise anew.
    pub fn observe(&mut self) -> Result<Observation, Box<dyn Error>> {
        let (scene, row) = (self.world.scene(), self.world.row());
        let view = View { scene, episode: 0, row, task: Task::S01, judge: &self.judge, reward: 0.0 };
        Ok(self.suite.observe(&view, SENSORS)?)
    }

    /// Counts on from a phase of the policy until it is pushed.
    fn note(&mut self, phase: &str) {
        if self.push.is_some() && self.pushed.0 == phase {
            self.pushed.1.get_or_insert(self.world.row().step + UNTIL_PUSH);
        }
    }

    /// A control step with a policy's answer to an observation; the next observation.
    pub fn step(&mut self, policy: &mut dyn Policy, seen: &Observation) -> Result<Observation, Box<dyn Error>> {
        let Command::JointTarget(wanted) = policy.act(seen)? else { return Err("no targets".into()) };
        // As a session does it, to the last bit.
        let q0 = self.world.scene().robot.q0();
        let action: Vec<f64> = wanted.iter().zip(q0).map(|(target, q0)| (target - q0) / ACTION_SCALE).collect();
        let targets: Vec<f64> = q0.iter().zip(&action).map(|(q0, action)| q0 + ACTION_SCALE * action).collect();
        let push = self.push.filter(|_| self.pushed.1 == Some(self.world.row().step));
        self.world.step_with(&ControlInput { push, ..ControlInput::new(&action, &targets) })?;
        self.judge.advance(self.world.row());
        self.observe()
    }
}

/// Plays the first episode of a room.
pub fn play(
    mut ladder: Ladder,
    seed: u64,
    changes: &Changes,
    mut watch: impl FnMut(&World, &str),
) -> Result<Played, Box<dyn Error>> {
    let mut game = Game::start(seed, changes)?;
    let mut seen = game.observe()?;
    ladder.reset(&game.info, &seen)?;
    let first = distance(&game.world);
    let (mut tilt, mut penetration) = (0.0_f64, 0.0_f64);
    let mut pressed = (0.0, "nothing");
    loop {
        let phase = ladder.phase().unwrap_or_default();
        game.note(&phase);
        let world = &game.world;
        tilt = tilt.max(measure::tilt(&world.row().things[errand::LADDER].pose));
        penetration = penetration.max(world.row().penetration);
        let now = touched(world);
        pressed = if now.0 > pressed.0 { now } else { pressed };
        watch(world, &phase);
        if let Some(end) = game.verdict().end {
            let feet = world.scene().geometry().ladder_feet(world.row()).into_iter().fold(0.0, f64::max);
            let seconds = end.step as f64 * CONTROL_DT;
            let distance = [first, distance(world)];
            return Ok(Played {
                cause: end.cause(),
                seconds,
                phase,
                distance,
                tilt,
                feet,
                touched: pressed,
                penetration,
            });
        }
        seen = game.step(&mut ladder, &seen)?;
    }
}
