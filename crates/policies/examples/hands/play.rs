//! One episode of `hands`, without a server.

use std::collections::VecDeque;
use std::error::Error;
use std::sync::Arc;

use fiatlux_client::{Command, Policy};
use fiatlux_policies::Hands;
use fiatlux_proto::v3::{SessionInfo, TaskInfo};
use fiatlux_render::Lighting;
use fiatlux_robot::{GainSet, Robot};
use fiatlux_rules::{Bulb, CONTROL_DT, Cause, Judge, JudgeOptions, Protocol, Row, Task, Thresholds, Verdict, errand};
use fiatlux_sensing::{NoiseSeed, Sensor, SensorSuite, Sensors, Setup, View};
use fiatlux_wire::{hand_body_names, joint_messages};
use fiatlux_world::{
    ACTION_SCALE, ControlInput, EpisodeSpec, Push, Scene, SceneConfig, StartOptions, World, start_drawn,
};
use nalgebra::Vector3;

const SENSORS: Sensors =
    Sensors::of(&[Sensor::Proprioception, Sensor::HandContact, Sensor::LastAction, Sensor::Privileged]);

/// Differences of an episode from the benchmark's.
#[derive(Debug, Clone, Default)]
pub struct Changes {
    /// The robot, in place of the benchmark's.
    pub robot: Option<String>,
    /// Friction of the hands, in place of the drawn one.
    pub friction: Option<f64>,
    /// Size of the fresh bulb.
    pub fresh_bulb: Option<f64>,
    /// Control steps until an action has an effect.
    pub delay: usize,
    /// A push of the whole robot, m/s, half a second after a phase began for the first time.
    pub push: Option<(f64, String)>,
}

/// The end of an episode.
#[allow(dead_code)]
pub struct Played {
    pub cause: Cause,
    pub seconds: f64,
    pub phase: String,
    /// Largest force of the task's bulb on a body of the hands, N, and without the first ten rows, whose grip is the start's.
    pub peak: f64,
    pub later_peak: f64,
    /// A bulb was broken or dropped.
    pub is_spoilt: bool,
    /// Deepest overlap of two shapes, m.
    pub penetration: f64,
}

/// A state of an episode, for whoever watches.
#[allow(dead_code)]
pub struct Moment<'a> {
    pub row: &'a Row,
    pub phase: &'a str,
    /// Distance of the hand from where it is commanded, m.
    pub off: f64,
    pub verdict: &'a Verdict,
}

/// The bulb that a task is about.
pub fn bulb_of(task: Task) -> Bulb {
    task.spec().bulbs.first().copied().unwrap_or(Bulb::Fresh)
}

/// Forces of a bulb on the bodies of the hands, N.
pub fn forces(row: &Row, bulb: Bulb) -> impl Iterator<Item = f64> {
    row.force(errand::HAND_FORCE[bulb as usize]).iter().map(|force| force.norm())
}

/// A session of a task, as far as `hands` reads it.
pub fn session(task: Task, robot: &Robot) -> SessionInfo {
    let gains = robot.gains(GainSet::default());
    SessionInfo {
        task: Some(TaskInfo { task: format!("{task:?}"), ..TaskInfo::default() }),
        joints: joint_messages(robot, &gains),
        hand_bodies: hand_body_names(robot),
        action_scale: ACTION_SCALE,
        control_dt: CONTROL_DT,
        ..SessionInfo::default()
    }
}

/// Plays the first episode of a room.
pub fn play(
    task: Task,
    seed: u64,
    mut hands: Hands,
    changes: &Changes,
    mut watch: impl FnMut(&Moment<'_>),
) -> Result<Played, Box<dyn Error>> {
    let robot = Arc::new(Robot::by_name(changes.robot.as_deref().unwrap_or(Robot::NAMES[0]))?);
    let gains = robot.gains(GainSet::default());
    let mut spec = EpisodeSpec::new(task, seed, 0);
    spec.scale.fresh_bulb = changes.fresh_bulb.unwrap_or(spec.scale.fresh_bulb);
    let mut of_scene = spec.scene(gains.clone());
    of_scene.hand_friction = changes.friction.or(of_scene.hand_friction);
    let scene = Arc::new(Scene::build(&SceneConfig::default(), Arc::clone(&robot), of_scene)?);
    let options = StartOptions { seed: Some(seed), ..StartOptions::default() };
    let (mut world, _) = start_drawn(Arc::clone(&scene), task, 0, &options)?;
    let mut judge =
        Judge::new(Protocol::Strict, task, Thresholds::default(), scene.geometry(), JudgeOptions::default());
    judge.start(world.row());
    let mut suite = SensorSuite::new(SENSORS, Setup::new(&scene, task));
    suite.begin(&scene, NoiseSeed::of(&spec), || unreachable!("no camera"), Lighting::default())?;

    let info = session(task, &robot);
    let view = |world: &World, judge: &Judge, suite: &mut SensorSuite| {
        let view = View { scene: &scene, episode: 0, row: world.row(), task, judge, reward: 0.0 };
        suite.observe(&view, SENSORS)
    };
    let mut observation = view(&world, &judge, &mut suite)?;
    hands.reset(&info, &observation)?;
    let bulb = bulb_of(task);
    let mut late: VecDeque<Vec<f64>> = std::iter::repeat_n(world.row().joint_target.clone(), changes.delay).collect();
    let (mut peak, mut later_peak, mut penetration, mut phase) =
        (forces(world.row(), bulb).fold(0.0, f64::max), 0.0_f64, 0.0_f64, String::new());
    let mut push_at = None;
    loop {
        if let Some(end) = judge.verdict().end {
            let is_spoilt = judge.verdict().broken || judge.verdict().dropped;
            let seconds = end.step as f64 * CONTROL_DT;
            return Ok(Played { cause: end.cause(), seconds, phase, peak, later_peak, is_spoilt, penetration });
        }
        let Command::JointTarget(targets) = hands.act(&observation)? else { return Err("no targets".into()) };
        late.push_back(targets);
        let wanted = late.pop_front().unwrap_or_default();
        // As a session does it, to the last bit.
        let action: Vec<f64> = wanted.iter().zip(robot.q0()).map(|(target, q0)| (target - q0) / ACTION_SCALE).collect();
        let targets: Vec<f64> = robot.q0().iter().zip(&action).map(|(q0, action)| q0 + ACTION_SCALE * action).collect();
        let step = world.row().step;
        let push = changes.push.as_ref().filter(|_| push_at == Some(step)).map(|(speed, _)| {
            let angle = 2.4 * seed as f64;
            Push { linear: *speed * Vector3::new(angle.cos(), angle.sin(), 0.0), angular: Vector3::zeros() }
        });
        world.step_with(&ControlInput { push, ..ControlInput::new(&action, &targets) })?;
        judge.advance(world.row());
        let row = world.row();
        let force = forces(row, bulb).fold(0.0, f64::max);
        peak = peak.max(force);
        later_peak = if row.step > 10 { later_peak.max(force) } else { later_peak };
        penetration = penetration.max(row.penetration);
        let off;
        (phase, off) = hands.progress().unwrap_or_default();
        if push_at.is_none() && changes.push.as_ref().is_some_and(|(_, during)| *during == phase) {
            push_at = Some(row.step + 25);
        }
        watch(&Moment { row, phase: &phase, off, verdict: judge.verdict() });
        observation = view(&world, &judge, &mut suite)?;
    }
}
