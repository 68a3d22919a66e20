//! One episode of the errand, without a server, from the start of any of its subtasks.

use std::error::Error;
use std::sync::Arc;

use fiatlux_client::{Command, Policy};
use fiatlux_policies::Expert;
use fiatlux_proto::v3::{SessionInfo, TaskInfo};
use fiatlux_render::Lighting;
use fiatlux_robot::{GainSet, Robot};
use fiatlux_rules::{CONTROL_DT, Judge, JudgeOptions, Protocol, Task, Thresholds};
use fiatlux_sensing::{NoiseSeed, Sensor, SensorSuite, Sensors, Setup, View};
use fiatlux_wire::{footprint_messages, hand_body_names, joint_messages};
use fiatlux_world::{ACTION_SCALE, ControlInput, EpisodeSpec, Scene, SceneConfig, StartOptions, World, start_drawn};

const SENSORS: Sensors =
    Sensors::of(&[Sensor::Proprioception, Sensor::HandContact, Sensor::LastAction, Sensor::Privileged]);
/// Control steps for which a robot stands where nothing plays what is due, until the episode is left.
const WAITS: u32 = 100;

/// Time after which an episode is left as stuck, s.
const MAX_SECONDS: f64 = 1000.0;

/// The end of an episode.
#[allow(dead_code)]
pub struct Played {
    /// Subtasks in the order in which they began for the first time, and when, s.
    pub stages: Vec<(Task, f64)>,
    pub seconds: f64,
    /// The cause of its end, `not played` where no skill plays what is due, or `stuck`.
    pub end: String,
}

/// Plays the first episode of a room from a subtask's start, by the rules of the errand.
pub fn play(start: Task, seed: u64, mut watch: impl FnMut(&World, &str)) -> Result<Played, Box<dyn Error>> {
    let robot = Arc::new(Robot::by_name(Robot::NAMES[0])?);
    let gains = robot.gains(GainSet::default());
    let spec = EpisodeSpec::new(start, seed, 0);
    let scene = Arc::new(Scene::build(&SceneConfig::default(), Arc::clone(&robot), spec.scene(gains.clone()))?);
    let options = StartOptions { seed: Some(seed), ..StartOptions::default() };
    let (mut world, _) = start_drawn(Arc::clone(&scene), start, 0, &options)?;
    let task = Task::Replace;
    let mut judge =
        Judge::new(Protocol::Strict, task, Thresholds::default(), scene.geometry(), JudgeOptions::default());
    judge.start(world.row());
    let mut suite = SensorSuite::new(SENSORS, Setup::new(&scene, task));
    suite.begin(&scene, NoiseSeed::of(&spec), || unreachable!("no camera"), Lighting::default())?;
    let info = SessionInfo {
        task: Some(TaskInfo { task: task.to_string(), ..TaskInfo::default() }),
        joints: joint_messages(&robot, &gains),
        hand_bodies: hand_body_names(&robot),
        footprints: footprint_messages(&scene),
        action_scale: ACTION_SCALE,
        control_dt: CONTROL_DT,
        ..SessionInfo::default()
    };
    let view = |world: &World, judge: &Judge, suite: &mut SensorSuite| {
        let view = View { scene: &scene, episode: 0, row: world.row(), task, judge, reward: 0.0 };
        suite.observe(&view, SENSORS)
    };
    let mut observation = view(&world, &judge, &mut suite)?;
    let mut expert = Expert::new()?;
    expert.reset(&info, &observation)?;
    let (mut stages, mut waited): (Vec<(Task, f64)>, u32) = (Vec::new(), 0);
    loop {
        let seconds = world.row().step as f64 * CONTROL_DT;
        let played = expert.progress();
        if let Some((task, _)) = played
            && stages.iter().all(|(known, _)| *known != task)
        {
            stages.push((task, seconds));
        }
        let phase = expert.phase().unwrap_or_default();
        watch(&world, &format!("{} {phase}", played.map_or_else(String::new, |(task, _)| task.to_string())));
        if seconds > MAX_SECONDS {
            return Ok(Played { stages, seconds, end: "stuck".into() });
        }
        if let Some(end) = judge.verdict().end {
            return Ok(Played { stages, seconds, end: format!("{:?}", end.cause()).to_lowercase() });
        }
        waited = if matches!(played, Some((_, true))) { 0 } else { waited + 1 };
        if waited > WAITS {
            return Ok(Played { stages, seconds, end: "not played".into() });
        }
        let Command::JointTarget(targets) = expert.act(&observation)? else { return Err("no targets".into()) };
        // As a session does it, to the last bit.
        let action: Vec<f64> =
            targets.iter().zip(robot.q0()).map(|(target, q0)| (target - q0) / ACTION_SCALE).collect();
        let targets: Vec<f64> = robot.q0().iter().zip(&action).map(|(q0, action)| q0 + ACTION_SCALE * action).collect();
        world.step_with(&ControlInput::new(&action, &targets))?;
        judge.advance(world.row());
        observation = view(&world, &judge, &mut suite)?;
    }
}
