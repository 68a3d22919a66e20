//! Kinds of batches, made from the settings that Python gives.

use std::collections::BTreeMap;
use std::sync::Arc;

use fiatlux_batch::{
    Autoreset, Bank, Batch as Worlds, BatchConfig, BatchError, Climbing, ClimbingOptions, Disturbances, MAX_STARTS,
    Rulebook, Start, Task, Walking, WalkingOptions, Watch,
};
use fiatlux_world::{EpisodeSpec, LadderPart, Scene, SceneConfig, SceneKind, SceneParts, SceneSpec};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};

use super::error::error;
use crate::build;
use crate::fault::{guarded, refused};
use crate::settings::{self, Settings};
use crate::state::set_part;

/// The task and seed of the room in which a robot walks that does not walk on a mere floor; a seed for training.
const WALKING_ROOM: (fiatlux_rules::Task, u64) = (fiatlux_rules::Task::S07, 1000);

/// A start of an episode: the task and seed and episode of whose start it is, its weight, and parts of the row to set in it.
type StartOf = (String, u64, u64, f64, Option<BTreeMap<String, Vec<f64>>>);

/// Settings that all batches share.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
struct Common<'py> {
    worlds: usize,
    threads: usize,
    seed: u64,
    autoreset: String,
    ranges: Option<Bound<'py, PyDict>>,
    variations: usize,
    disturbances: Option<Bound<'py, PyDict>>,
    links: Vec<String>,
    forces: bool,
    contacts: bool,
}

impl Common<'_> {
    fn config(&self, banks: Vec<Bank>, disturbances: Disturbances) -> PyResult<BatchConfig> {
        let autoreset = match self.autoreset.as_str() {
            "SameStep" => Autoreset::SameStep,
            "NextStep" => Autoreset::NextStep,
            "Disabled" => Autoreset::Disabled,
            name => return Err(PyValueError::new_err(format!("autoreset_mode is '{name}'"))),
        };
        let Self { worlds, threads, seed, .. } = *self;
        let watch = Watch { links: self.links.clone(), forces: self.forces, contacts: self.contacts };
        Ok(BatchConfig { worlds, threads, seed, banks, disturbances, autoreset, watch })
    }

    /// Refuses ranges that the benchmark's tasks alone draw from.
    fn refuse_task_ranges(&self, task: &str) -> PyResult<()> {
        let (delay, noise) = build::task_ranges(self.ranges.as_ref())?;
        let camera = build::camera_ranges(self.ranges.as_ref())?;
        if delay.is_some() || noise.is_some() || camera.iter().next().is_some() {
            let rule = format!("are for the benchmark's tasks; {task} has none of them");
            return Err(PyValueError::new_err(format!("ranges: action_delay, noise and camera {rule}")));
        }
        Ok(())
    }

    /// Draws what varies from start to start.
    fn vary(&self, banks: Vec<Bank>) -> PyResult<Vec<Bank>> {
        let Some(ranges) = build::ranges(self.ranges.as_ref())? else { return Ok(banks) };
        let starts: usize = banks.iter().map(|bank| bank.starts.len()).sum();
        if starts.saturating_mul(self.variations) > MAX_STARTS {
            let found = self.variations;
            let rule = format!("with {starts} starts, give at most {}", MAX_STARTS / starts);
            return Err(error(BatchError::Config { field: "variations", found, rule }));
        }
        Ok(banks.into_iter().map(|bank| bank.varied(&ranges, self.variations, self.seed)).collect())
    }
}

/// Settings of the walking task.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
struct WalkingSettings {
    scene: String,
    robot: String,
    gains: String,
    frames: usize,
    noise: bool,
    horizon_steps: u64,
    command: [[f64; 2]; 3],
    height: [f64; 2],
    stand_height: [f64; 2],
    torso: [[f64; 2]; 3],
    arm_range: f64,
    load_kg: f64,
    hand_force_n: f64,
    reward_weights: BTreeMap<String, f64>,
}

/// Settings of the climbing task.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
struct ClimbingSettings {
    robot: String,
    gains: String,
    noise: bool,
    horizon_steps: u64,
    until: f64,
    starts: Vec<[f64; 2]>,
    rates: [f64; 2],
    backwards: f64,
    holds: f64,
    arms: Vec<[f64; 14]>,
    carries: f64,
    reward_weights: BTreeMap<String, f64>,
}

/// Makes the worlds of a kind. The arguments of `rulebook` are a task, starts, and two dictionaries of settings; those of the others
/// are the dictionaries.
pub(super) fn made(kind: &str, arguments: &Bound<'_, PyTuple>) -> PyResult<Worlds> {
    let py = arguments.py();
    match kind {
        "rulebook" => {
            let (task, starts, settings, common): (String, Vec<StartOf>, Settings, Common<'_>) = arguments.extract()?;
            rulebook(py, &task, starts, settings, common)
        }
        "climbing" => {
            let (settings, common): (ClimbingSettings, Common<'_>) = arguments.extract()?;
            climbing(py, settings, common)
        }
        _ => {
            let (settings, common): (WalkingSettings, Common<'_>) = arguments.extract()?;
            walking(py, settings, common)
        }
    }
}

/// Builds without the interpreter's lock, so that other Python threads can run.
fn built(py: Python<'_>, config: BatchConfig, task: &dyn Task) -> PyResult<Worlds> {
    let worlds = py.detach(|| guarded(|| Worlds::new(config, task)))?.map_err(error)?;
    py.check_signals()?;
    Ok(worlds)
}

/// Worlds of a task of the benchmark.
fn rulebook(
    py: Python<'_>,
    task: &str,
    starts: Vec<StartOf>,
    settings: Settings,
    common: Common<'_>,
) -> PyResult<Worlds> {
    let task = build::task(task)?;
    let (robot, gains) = settings.robot()?;
    let mut options = settings.rulebook(task)?;
    let (delay, noise) = build::task_ranges(common.ranges.as_ref())?;
    options.noise_scale = noise.unwrap_or(options.noise_scale);
    if let Some([least, most]) = delay {
        options.action_delay = [settings::delay_steps(least)?, settings::delay_steps(most)?];
        if least > most {
            return Err(PyValueError::new_err("ranges: action_delay must be [least, most], ms"));
        }
    }
    options.camera = build::camera_ranges(common.ranges.as_ref())?;
    let network = settings.network(options.sensors.sensors())?;
    let disturbances = build::disturbances(&robot, common.disturbances.as_ref())?;
    let config = SceneConfig::default();
    // One start at a time, so that Ctrl-C works: staging one takes a tenth of a second.
    let mut banks: Vec<Bank> = Vec::new();
    let mut staged: BTreeMap<(String, u64, u64), (usize, Start)> = BTreeMap::new();
    for (of, seed, episode, weight, parts) in starts {
        let key = (of, seed, episode);
        if !staged.contains_key(&key) {
            let other = build::task(&key.0)?;
            if SceneKind::of(other) != SceneKind::of(task) {
                let rule = "S01 and replace share one, S02 to S12 another one, and climb has its own";
                return Err(PyValueError::new_err(format!(
                    "starts: {other} plays in another scene than {task}; {rule}"
                )));
            }
            let spec = [settings.episode(other, seed, episode)?];
            let made = py.detach(|| guarded(|| Bank::of_episodes(&config, &robot, &gains, &spec)))?;
            for mut bank in made.map_err(|error| refused(&error))? {
                let start = bank.starts.remove(0);
                let known = banks.iter().position(|known| known.scene.spec == bank.scene.spec);
                let index = known.unwrap_or(banks.len());
                if known.is_none() {
                    banks.push(bank);
                }
                staged.insert(key.clone(), (index, start));
            }
            py.check_signals()?;
        }
        let Some((index, start)) = staged.get(&key) else { continue };
        let mut start = Start { weight, ..start.clone() };
        for (name, numbers) in parts.iter().flatten() {
            set_part(&mut start.row, name, numbers)?;
        }
        banks[*index].starts.push(start);
    }
    let banks = common.vary(banks)?;
    let Some(first) = banks.first() else {
        return Err(error(BatchError::Config { field: "seeds", found: 0, rule: "give at least one".into() }));
    };
    let rulebook = Rulebook::new(task, &first.scene, options, network).map_err(|error| refused(&*error))?;
    built(py, common.config(banks, disturbances)?, &rulebook)
}

/// Worlds of walking by velocity command, on a floor, or outside the walls of a room that is simulated as well.
fn walking(py: Python<'_>, settings: WalkingSettings, common: Common<'_>) -> PyResult<Worlds> {
    let (robot, gains) = settings::robot(&settings.robot, &settings.gains)?;
    let disturbances = build::disturbances(&robot, common.disturbances.as_ref())?;
    let spec = match settings.scene.as_str() {
        "floor" => SceneSpec::floor(gains),
        "room" => EpisodeSpec::new(WALKING_ROOM.0, WALKING_ROOM.1, 0).scene(gains),
        name => return Err(PyValueError::new_err(format!("scene is '{name}'; known ones are floor, room"))),
    };
    let scene = Scene::build(&SceneConfig::default(), robot, spec);
    let scene = Arc::new(scene.map_err(|error| refused(&error))?);
    let banks = common.vary(vec![Bank::standing(Arc::clone(&scene))])?;
    common.refuse_task_ranges("walking")?;
    let options = WalkingOptions {
        frames: settings.frames,
        noise: settings.noise,
        horizon_steps: settings.horizon_steps,
        command: settings.command,
        height: settings.height,
        stand_height: settings.stand_height,
        torso: settings.torso,
        arm_range: settings.arm_range,
        load_kg: settings.load_kg,
        hand_force_n: settings.hand_force_n,
        reward_weights: settings.reward_weights,
    };
    let walking = Walking::new(&scene, options).map_err(|error| refused(&*error))?;
    built(py, common.config(banks, disturbances)?, &walking)
}

fn climbing(py: Python<'_>, settings: ClimbingSettings, common: Common<'_>) -> PyResult<Worlds> {
    let (robot, gains) = settings::robot(&settings.robot, &settings.gains)?;
    let disturbances = build::disturbances(&robot, common.disturbances.as_ref())?;
    let parts = SceneParts { ladder: Some(LadderPart::Free), ..SceneParts::FLOOR };
    let scene = Scene::build(&SceneConfig::default(), robot, SceneSpec::new(parts, 0, gains));
    let scene = Arc::new(scene.map_err(|error| refused(&error))?);
    let banks = common.vary(vec![Bank::standing(Arc::clone(&scene))])?;
    common.refuse_task_ranges("climbing")?;
    let options = ClimbingOptions {
        noise: settings.noise,
        horizon_steps: settings.horizon_steps,
        until: settings.until,
        starts: settings.starts,
        rates: settings.rates,
        backwards: settings.backwards,
        holds: settings.holds,
        arms: settings.arms,
        carries: settings.carries,
        reward_weights: settings.reward_weights,
    };
    let climbing = Climbing::new(&scene, options).map_err(|error| refused(&*error))?;
    built(py, common.config(banks, disturbances)?, &climbing)
}
