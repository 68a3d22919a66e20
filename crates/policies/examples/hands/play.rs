//! One episode of `hands`, without a server.

use std::error::Error;
use std::sync::Arc;

use fiatlux_client::{Command, Policy};
use fiatlux_policies::Hands;
use fiatlux_proto::v3::{Joint, SessionInfo, TaskInfo};
use fiatlux_render::Lighting;
use fiatlux_robot::{GainSet, JointGains, Robot};
use fiatlux_rules::{Bulb, CONTROL_DT, Cause, Row, Task, errand};
use fiatlux_sensing::{NoiseSeed, Sensor, SensorSuite, Sensors, Setup, View};
use fiatlux_world::{ACTION_SCALE, Episode, EpisodeSpec, Scene, SceneConfig};

const SENSORS: Sensors =
    Sensors::of(&[Sensor::Proprioception, Sensor::HandContact, Sensor::LastAction, Sensor::Privileged]);

/// How an episode ended.
pub struct Played {
    pub cause: Cause,
    pub seconds: f64,
    pub phase: String,
    /// Largest force of the bulb on a body of the hands, N.
    pub peak: f64,
}

/// Forces of the fresh bulb on the bodies of the hands, N.
pub fn forces(row: &Row) -> impl Iterator<Item = f64> {
    row.force(errand::HAND_FORCE[Bulb::Fresh as usize]).iter().map(|force| force.norm())
}

/// Plays the first episode of a room. `watch` is given each state, the phase, and the hand's distance from its goal, m.
pub fn play(
    task: Task,
    seed: u64,
    mut hands: Hands,
    mut watch: impl FnMut(&Episode, &str, f64),
) -> Result<Played, Box<dyn Error>> {
    let robot = Arc::new(Robot::g1_inspire()?);
    let gains = robot.gains(GainSet::default());
    let spec = EpisodeSpec::new(task, seed, 0);
    let scene = Arc::new(Scene::build(&SceneConfig::default(), Arc::clone(&robot), spec.scene(gains.clone()))?);
    let mut episode = Episode::start(Arc::clone(&scene), &spec)?;
    let mut suite = SensorSuite::new(SENSORS, Setup::new(&scene, task));
    suite.begin(&scene, NoiseSeed::of(&spec), || unreachable!("no camera"), Lighting::default())?;
    let joint = |((joint, q0), gains): ((&fiatlux_robot::Joint, &f64), &JointGains)| Joint {
        name: joint.name.clone(),
        q0: *q0,
        stiffness: gains.stiffness,
        damping: gains.damping,
        effort_limit: gains.effort_limit,
        ..Joint::default()
    };
    let info = SessionInfo {
        task: Some(TaskInfo { task: format!("{task:?}"), ..TaskInfo::default() }),
        joints: robot.joints().iter().zip(robot.q0()).zip(&gains.0).map(joint).collect(),
        hand_bodies: robot.hand_links().iter().map(|&link| robot.links()[link].name.clone()).collect(),
        action_scale: ACTION_SCALE,
        control_dt: CONTROL_DT,
        ..SessionInfo::default()
    };
    let mut observation = suite.observe(&View::of(&episode), SENSORS)?;
    hands.reset(&info, &observation)?;
    let (mut peak, mut phase) = (0.0_f64, String::new());
    loop {
        if let Some(end) = episode.end() {
            return Ok(Played { cause: end.cause(), seconds: end.step as f64 * CONTROL_DT, phase, peak });
        }
        let Command::JointTarget(targets) = hands.act(&observation)? else { return Err("no targets".into()) };
        let action = episode.action_for(&targets);
        episode.step(&action)?;
        peak = forces(episode.row()).fold(peak, f64::max);
        let off;
        (phase, off) = hands.progress().unwrap_or_default();
        watch(&episode, &phase, off);
        observation = suite.observe(&View::of(&episode), SENSORS)?;
    }
}
