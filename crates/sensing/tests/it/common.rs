//! Shared helpers of the sensors' tests.
#![allow(clippy::unwrap_used, dead_code)]

use std::path::Path;
use std::sync::Arc;

use fiatlux_features::{ResNet18, Weights};
use fiatlux_proto::v3::Observation;
use fiatlux_render::{Lighting, Visuals};
use fiatlux_robot::{GainSet, Gains, Robot};
use fiatlux_rules::{Judge, JudgeOptions, Protocol, Row, Task, Thresholds};
use fiatlux_sensing::{NoiseSeed, Observer, Proprioception, Sensor, SensorSuite, Sensors, Setup, Sight, View};
use fiatlux_world::{Scene, SceneConfig, SceneKind, SceneSpec, StartOptions, World, start};

/// The scene that a task plays in, layout seed 0, with all gains multiplied.
pub fn scene(task: Task, stiffer: f64) -> Arc<Scene> {
    let robot = Arc::new(Robot::benchmark().unwrap());
    let mut gains: Gains = robot.gains(GainSet::Fiatlux);
    for drive in &mut gains.0 {
        drive.stiffness *= stiffer;
        drive.damping *= stiffer;
        drive.effort_limit *= stiffer;
    }
    let spec = SceneSpec::new(SceneKind::of(task), 0, gains);
    Arc::new(Scene::build(&SceneConfig::default(), robot, spec).unwrap())
}

/// The start of a task's episode 0.
pub fn started(scene: &Arc<Scene>, task: Task) -> World {
    start(Arc::clone(scene), task, 0, &StartOptions::default()).unwrap()
}

/// The start row of a task's episode 0.
pub fn start_row(task: Task) -> (Arc<Scene>, Row) {
    let scene = scene(task, 1.0);
    let row = started(&scene, task).row().clone();
    (scene, row)
}

/// Joint angles of the standing posture, rad.
pub fn q0(scene: &Scene) -> Vec<f64> {
    scene.robot.q0().to_vec()
}

fn view<'a>(scene: &'a Scene, row: &'a Row, task: Task, judge: &'a Judge) -> View<'a> {
    View { scene, row, start: &row.robot.pose, task, episode: 0, judge, reward: 0.5 }
}

/// Sensors of a scene, for rows of the test's own.
pub struct Rig {
    pub scene: Arc<Scene>,
    pub suite: SensorSuite,
    pub setup: Setup,
    judge: Judge,
}

impl Rig {
    /// Pictures are small: the network is slow.
    pub fn new(scene: &Arc<Scene>, row: &Row, task: Task, sensors: Sensors, seed: Option<NoiseSeed>) -> Self {
        Self::with_sight(scene, row, task, sensors, seed, Sight::Published)
    }

    pub fn with_sight(
        scene: &Arc<Scene>,
        row: &Row,
        task: Task,
        sensors: Sensors,
        seed: Option<NoiseSeed>,
        sight: Sight,
    ) -> Self {
        let setup = Setup { image_size: [64, 32], ..Setup::new(scene, task) };
        let network = sensors.meets(Sensors::WITH_FEATURES).then(|| ResNet18::new(&Weights::seeded(0)));
        let mut suite = SensorSuite::new(sensors, setup).with_sight(sight).with_network(network);
        suite.begin(scene, seed, || Arc::new(Visuals::new(scene)), Lighting::default()).unwrap();
        let mut judge =
            Judge::new(Protocol::Strict, task, Thresholds::default(), scene.geometry(), JudgeOptions::default());
        judge.start(row);
        Self { scene: Arc::clone(scene), suite, setup, judge }
    }

    pub fn compute(&mut self, sensor: Sensor, row: &Row) -> Vec<f32> {
        let mut numbers = vec![f32::NAN; self.suite.length(sensor)];
        let Self { scene, suite, setup, judge } = self;
        suite.compute(sensor, &view(scene, row, setup.task, judge), &mut numbers).unwrap();
        numbers
    }

    /// A message with these sensors.
    pub fn observe(&mut self, sensors: Sensors, row: &Row) -> Observation {
        let Self { scene, suite, setup, judge } = self;
        suite.observe(&view(scene, row, setup.task, judge), sensors).unwrap()
    }
}

pub fn sensed(observer: &mut Observer, row: &Row) -> Proprioception {
    let mut sensed = Proprioception::zeros(0);
    observer.observe(row, &mut sensed);
    sensed
}

/// Compares a part of `OBSERVATIONS.md`, between the comments `<!-- NAME -->` and `<!-- end of NAME -->`, with what was
/// made anew; with FIATLUX_BLESS set, writes it instead.
pub fn document(name: &str, made: &str) {
    let (old, start, end) = part(name);
    if old[start..end] == *made {
        return;
    }
    assert!(blessing(), "OBSERVATIONS.md: part '{name}' is out of date; run the test with FIATLUX_BLESS=1");
    std::fs::write(path(), format!("{}{made}{}", &old[..start], &old[end..])).unwrap();
}

/// As [`document`] for what was measured: it is written, never compared.
pub fn document_measured(name: &str, made: &str) {
    if blessing() {
        document(name, made);
    }
}

fn blessing() -> bool {
    std::env::var_os("FIATLUX_BLESS").is_some()
}

fn path() -> std::path::PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("OBSERVATIONS.md")
}

fn part(name: &str) -> (String, usize, usize) {
    let text = std::fs::read_to_string(path()).unwrap();
    let (open, close) = (format!("<!-- {name} -->\n"), format!("<!-- end of {name} -->"));
    let start = text.find(&open).unwrap() + open.len();
    let end = text.find(&close).unwrap();
    (text, start, end)
}
