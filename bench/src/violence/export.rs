//! Exports the same starts and targets for MuJoCo: scenes and numbers that `tests/oracle/violence.py` reads.

use fiatlux_rules::errand;
use std::fs;
use std::path::Path;

use fiatlux_dynamics::{BodyId, Drive, Model, State};
use fiatlux_mjcf::{MjcfOptions, Names, OptionSet, to_mjcf};
use fiatlux_world::{PHYSICS_DT, SUBSTEPS, Scene};
use serde_json::{Value, json};

use super::ViolenceOptions;
use super::accuracy::{self, AT, FINE, RUNS};
use super::flight;
use super::trial::{HOLD, Trials};
use crate::BenchError;

/// Writes `flight.xml` and `flight.json`, the starts in empty space; `starts.xml` and `starts.json`, the random starts;
/// and for the error `replay-N.xml` and `replays.json`, which hold the states that the engine reached.
pub fn export(folder: &Path, options: &ViolenceOptions) -> Result<(), BenchError> {
    fs::create_dir_all(folder)
        .map_err(|source| BenchError::Io { what: format!("make folder '{}'", folder.display()), source })?;
    write(&folder.join("flight.json"), flight(folder)?.to_string())?;
    let trials = Trials::new()?;
    let starts = starts(folder, &trials, options.starts)?;
    write(&folder.join("starts.json"), starts.to_string())?;
    let replays = replays(folder, &trials, options.runs.clamp(1, RUNS))?;
    write(&folder.join("replays.json"), replays.to_string())
}

fn flight(folder: &Path) -> Result<Value, BenchError> {
    let model = flight::robot_in_space()?;
    write(&folder.join("flight.xml"), mjcf(&model, &model.reference_state(), &[]))?;
    let starts = |speed: f64| -> Vec<_> {
        flight::starts(&model, speed).map(|state| json!({"qpos": state.qpos, "qvel": state.qvel})).collect()
    };
    let speeds = flight::JOINT_SPEEDS.map(|speed| json!({"joint_speed": speed, "starts": starts(speed)}));
    Ok(json!({"steps": flight::STEPS, "speeds": speeds}))
}

fn starts(folder: &Path, trials: &Trials, count: u64) -> Result<Value, BenchError> {
    let mut starts = Vec::new();
    let mut settings = Value::Null;
    for index in 0..count {
        let (world, sets) = trials.start_and_targets(index)?;
        let (scene, state) = (world.scene(), world.state());
        let sets: Vec<_> = sets.iter().map(|targets| accuracy::driven(scene, targets)).collect();
        if index == 0 {
            write(&folder.join("starts.xml"), mjcf(&scene.model, state, &sets[0]))?;
            settings = names(scene);
        }
        starts.push(json!({"qpos": state.qpos, "qvel": state.qvel, "targets": sets}));
    }
    Ok(json!({"hold": HOLD * SUBSTEPS, "scene": settings, "starts": starts}))
}

fn replays(folder: &Path, trials: &Trials, runs: u64) -> Result<Value, BenchError> {
    let mut replays = Vec::new();
    for run in 0..runs {
        fiatlux_cli::report(format!("bench: replay {run} of {runs}"));
        let world = trials.start(run)?;
        let (scene, start) = (world.scene(), world.state());
        let file = format!("replay-{run}.xml");
        let mut patterns = serde_json::Map::new();
        for pattern in accuracy::PATTERNS {
            let targets = accuracy::targets(scene, pattern, run);
            if patterns.is_empty() {
                write(&folder.join(&file), mjcf(&scene.model, start, &targets[0]))?;
            }
            let roll = |parts: usize| -> Vec<_> {
                accuracy::roll(scene, start, &targets, parts).into_iter().map(|state| state.qpos).collect()
            };
            let (coarse, fine) = (roll(1), roll(FINE));
            patterns.insert(pattern.name(), json!({"targets": targets, "coarse": coarse, "fine": fine}));
        }
        replays.push(json!({"file": file, "scene": names(scene), "patterns": patterns}));
    }
    Ok(json!({"hold": SUBSTEPS, "after": AT, "finer": FINE, "replays": replays}))
}

/// Facts about a scene that the script needs and that MJCF does not hold.
fn names(scene: &Scene) -> Value {
    let model = &scene.model;
    let name = |body: BodyId| &model.bodies()[body.0].spec.name;
    // Infinite if a drive has no rated speed, which JSON writes as null.
    let speed_limits: Vec<_> = model.drives().iter().map(|(_, drive)| drive.speed_limit).collect();
    json!({
        "pelvis": name(scene.robot_ids.root),
        "ladder": scene.body(errand::LADDER).map(name),
        "bulbs": [scene.body(errand::OLD_BULB).map(name), scene.body(errand::FRESH_BULB).map(name)],
        "corner": Drive::CORNER,
        "speed_limits": speed_limits,
    })
}

fn mjcf(model: &Model, state: &State, targets: &[f64]) -> String {
    let options = MjcfOptions {
        name: "violence".into(),
        timestep: PHYSICS_DT,
        option_set: OptionSet::Nearest,
        names: Names::default(),
    };
    to_mjcf(model, state, targets, &options)
}

fn write(path: &Path, text: String) -> Result<(), BenchError> {
    fs::write(path, text).map_err(|source| BenchError::Io { what: format!("write '{}'", path.display()), source })
}
