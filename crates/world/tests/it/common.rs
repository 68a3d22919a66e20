//! What the tests of the sensors share.
#![allow(clippy::unwrap_used, dead_code)]

use std::path::Path;
use std::sync::Arc;

use fiatlux_robot::{GainSet, Gains, Robot};
use fiatlux_rules::{Row, Task};
use fiatlux_world::{Observer, Proprioception, Scene, SceneConfig, SceneKind, SceneSpec, StartOptions, World, start};

/// The scene that a task plays in, layout seed 0, with all gains multiplied.
pub fn scene(task: Task, stiffer: f64) -> Arc<Scene> {
    let robot = Arc::new(Robot::g1_inspire().unwrap());
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

/// Standing posture.
pub fn q0(scene: &Scene) -> Vec<f64> {
    scene.robot.q0().to_vec()
}

/// The next observation.
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
