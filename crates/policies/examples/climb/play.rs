//! One episode of `climb`, without a server.

use std::error::Error;
use std::f64::consts::FRAC_PI_2;
use std::sync::Arc;

use fiatlux_client::{Command, Policy};
use fiatlux_policies::Climb;
use fiatlux_proto::v3::{SessionInfo, TaskInfo};
use fiatlux_render::Lighting;
use fiatlux_robot::{GainSet, Robot};
use fiatlux_rules::{CONTROL_DT, Cause, Row, Task, errand};
use fiatlux_sensing::{NoiseSeed, Sensor, SensorSuite, Sensors, Setup, View};
use fiatlux_wire::joint_messages;
use fiatlux_world::{ACTION_SCALE, Episode, EpisodeSpec, Scene, SceneConfig};
use nalgebra::{Isometry3, Vector3};

const SENSORS: Sensors = Sensors::of(&[Sensor::Proprioception, Sensor::LastAction, Sensor::Privileged]);

/// The end of an episode.
#[derive(Debug)]
pub struct Played {
    pub cause: Cause,
    pub seconds: f64,
    /// Time in the plan and of the whole plan, s.
    pub progress: Option<(f64, f64)>,
    /// Of the pelvis at the end, m.
    pub height: f64,
    /// Way of the ladder, m, and its largest tilt, rad.
    pub ladder: (f64, f64),
    /// Largest effort of a joint relative to its limit, as measured at the ends of steps.
    pub effort: f64,
}

/// Pose of the pelvis in the ladder's frame with x into it from the side of its steps.
pub fn ladder_from_pelvis(row: &Row) -> Isometry3<f64> {
    let ladder = row.things[errand::LADDER].pose * Isometry3::rotation(Vector3::z() * FRAC_PI_2);
    ladder.inverse() * row.robot.pose
}

/// Plays the first episode of a room. `watch` is given each state and the time in the plan, s.
pub fn play(
    mut climb: Climb,
    task: Task,
    seed: u64,
    mut watch: impl FnMut(&Episode, Option<f64>),
) -> Result<Played, Box<dyn Error>> {
    let robot = Arc::new(Robot::benchmark()?);
    let gains = robot.gains(GainSet::default());
    let spec = EpisodeSpec::new(task, seed, 0);
    let scene = Arc::new(Scene::build(&SceneConfig::default(), Arc::clone(&robot), spec.scene(gains.clone()))?);
    let mut episode = Episode::start(Arc::clone(&scene), &spec)?;
    let mut suite = SensorSuite::new(SENSORS, Setup::new(&scene, task));
    suite.begin(&scene, NoiseSeed::of(&spec), || unreachable!("no camera"), Lighting::default())?;
    let name = if task == Task::Climb { "climb".into() } else { format!("{task:?}") };
    let info = SessionInfo {
        task: Some(TaskInfo { task: name, ..TaskInfo::default() }),
        joints: joint_messages(&robot, &gains),
        action_scale: ACTION_SCALE,
        control_dt: CONTROL_DT,
        ..SessionInfo::default()
    };
    let mut observation = suite.observe(&View::of(&episode), SENSORS)?;
    climb.reset(&info, &observation)?;
    let start = episode.row().things[errand::LADDER].pose;
    let (mut ladder, mut effort) = ((0.0_f64, 0.0_f64), 0.0_f64);
    loop {
        let row = episode.row();
        let now = row.things[errand::LADDER].pose;
        let moved = (now.translation.vector - start.translation.vector).norm();
        ladder = (ladder.0.max(moved), ladder.1.max(now.rotation.angle_to(&start.rotation)));
        let shares = row.joint_effort.iter().zip(&gains.0).map(|(effort, gains)| effort.abs() / gains.effort_limit);
        effort = shares.fold(effort, f64::max);
        let progress = climb.progress();
        watch(&episode, progress.map(|(time, _)| time));
        if let Some(end) = episode.end() {
            let height = row.robot.pose.translation.z;
            return Ok(Played {
                cause: end.cause(),
                seconds: end.step as f64 * CONTROL_DT,
                progress,
                height,
                ladder,
                effort,
            });
        }
        let Command::JointTarget(targets) = climb.act(&observation)? else { return Err("no targets".into()) };
        let action = episode.action_for(&targets);
        episode.step(&action)?;
        observation = suite.observe(&View::of(&episode), SENSORS)?;
    }
}
