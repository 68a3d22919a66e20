//! Batches that read and write NumPy arrays.

use std::collections::BTreeMap;
use std::sync::Arc;

use fiatlux_batch::{
    Autoreset, Bank, Batch as Worlds, BatchConfig, BatchError, Begin, Buffers, Climbing, ClimbingOptions, Disturbances,
    Drawn, MAX_STARTS, Rulebook, Snapshot as Saved, Start, Task, Walking, WalkingOptions, Watch,
};
use fiatlux_render::Lighting;
use fiatlux_rules::Row;
use fiatlux_world::{EpisodeSpec, LadderPart, Scene, SceneConfig, SceneKind, SceneParts, SceneSpec};
use numpy::{IntoPyArray, PyArrayDyn, PyArrayMethods, PyReadonlyArray1, PyReadonlyArrayDyn, PyReadwriteArrayDyn};
use pyo3::exceptions::{PyMemoryError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict, PyTuple};

use crate::build;
use crate::episode::describe_verdicts;
use crate::fault::{failed, guarded, not_contiguous, own, own_mut, refused};
use crate::painter::Painter;
use crate::settings::{self, Settings};
use crate::state::{self, Parts, describe_row, set_part, set_parts};

/// The task and seed of the room in which a robot walks that does not walk on a mere floor; a seed for training.
const WALKING_ROOM: (fiatlux_rules::Task, u64) = (fiatlux_rules::Task::S07, 1000);

/// Many worlds that step together.
#[pyclass(module = "fiatlux._native")]
pub(crate) struct Batch {
    worlds: Worlds,
    painter: Painter,
    /// Constructor call that copies repeat: `kind` and `arguments`.
    recipe: (String, Py<PyTuple>),
}

/// State of a batch that can be restored later, here or, pickled, in another process with the same version.
#[pyclass(module = "fiatlux._native", frozen)]
pub(crate) struct Snapshot(Saved);

/// Constructor, arguments and state for pickle.
type Reduced<'py> = (Bound<'py, PyAny>, (String, Py<PyTuple>, Snapshot));

#[pymethods]
impl Snapshot {
    #[new]
    fn new(bytes: &[u8]) -> PyResult<Self> {
        guarded(|| Saved::from_bytes(bytes))?.map(Self).map_err(error)
    }

    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyAny>, (Bound<'py, PyBytes>,))> {
        let bytes = guarded(|| self.0.to_bytes())?;
        Ok((py.get_type::<Self>().into_any(), (PyBytes::new(py, &bytes),)))
    }

    fn __deepcopy__<'py>(this: Bound<'py, Self>, _memo: Bound<'py, PyAny>) -> Bound<'py, Self> {
        // It never changes.
        this
    }
}

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

pub(crate) fn error(error: BatchError) -> PyErr {
    match error {
        BatchError::Config { field, found, rule } => {
            // As the arguments are called in Python.
            let field = match field {
                "worlds" => "num_envs",
                "threads" => "num_threads",
                other => other,
            };
            PyValueError::new_err(format!("{field} is {found}; {rule}"))
        }
        BatchError::Memory { .. } => PyMemoryError::new_err(error.to_string().replace("worlds:", "num_envs:")),
        BatchError::Ended { world } => {
            let remedy = "call reset(options={\"reset_mask\": terminated | truncated}) before the next step";
            PyValueError::new_err(format!("the episode of world {world} has ended; {remedy}"))
        }
        BatchError::Row { world, problem } => {
            PyValueError::new_err(format!("like: world {world} cannot begin there: {problem}"))
        }
        BatchError::StartRow { problem, .. } => {
            PyValueError::new_err(format!("starts: no world starts there: {problem}"))
        }
        BatchError::World { .. }
        | BatchError::Forked { .. }
        | BatchError::Task { .. }
        | BatchError::Panicked { .. }
        | BatchError::Stopped
        | BatchError::Torn
        | BatchError::Thread(_) => failed(&error),
        _ => refused(&error),
    }
}

/// An array to write to. It is borrowed after the batch is, so that a second thread hears of the batch.
fn writable<'py, T: numpy::Element>(
    array: &Bound<'py, PyArrayDyn<T>>,
    field: &str,
) -> PyResult<PyReadwriteArrayDyn<'py, T>> {
    array.try_readwrite().map_err(|error| PyValueError::new_err(format!("{field}: {error}")))
}

/// Builds without the interpreter's lock, so that other Python threads can run.
fn built(py: Python<'_>, config: BatchConfig, task: &dyn Task) -> PyResult<Worlds> {
    let worlds = py.detach(|| guarded(|| Worlds::new(config, task)))?.map_err(error)?;
    py.check_signals()?;
    Ok(worlds)
}

#[pymethods]
impl Batch {
    /// Worlds of a kind, which continue from a snapshot if there is one. The arguments of `rulebook` are a task, starts, and two
    /// dictionaries of settings; those of `walking` are the dictionaries.
    #[new]
    #[pyo3(signature = (kind, arguments, snapshot=None))]
    fn new(kind: &str, arguments: Bound<'_, PyTuple>, snapshot: Option<&Snapshot>) -> PyResult<Self> {
        let py = arguments.py();
        let mut worlds = if kind == "rulebook" {
            let (task, starts, settings, common): (String, Vec<StartOf>, Settings, Common<'_>) = arguments.extract()?;
            Self::rulebook(py, &task, starts, settings, common)?
        } else if kind == "climbing" {
            let (settings, common): (ClimbingSettings, Common<'_>) = arguments.extract()?;
            Self::climbing(py, settings, common)?
        } else {
            let (settings, common): (WalkingSettings, Common<'_>) = arguments.extract()?;
            Self::walking(py, settings, common)?
        };
        if let Some(Snapshot(saved)) = snapshot {
            let mut observation = vec![0.0; worlds.worlds() * worlds.spec().observation_length()];
            guarded(|| worlds.restore(saved, &mut observation))?.map_err(error)?;
        }
        Ok(Self { worlds, painter: Painter::default(), recipe: (kind.to_owned(), arguments.unbind()) })
    }

    /// A copy is made from the same arguments, and continues from the same state.
    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<Reduced<'py>> {
        let (kind, arguments) = &self.recipe;
        Ok((py.get_type::<Self>().into_any(), (kind.clone(), arguments.clone_ref(py), self.saved(None)?)))
    }

    /// The usual weight of each term of the walking task's reward, a second.
    #[staticmethod]
    fn walking_weights() -> BTreeMap<&'static str, f64> {
        WalkingOptions::usual_reward_weights().collect()
    }

    /// The usual weight of each term of the climbing task's reward, a second.
    #[staticmethod]
    fn climbing_weights() -> BTreeMap<&'static str, f64> {
        ClimbingOptions::usual_reward_weights().collect()
    }

    #[getter]
    fn num_worlds(&self) -> usize {
        self.worlds.worlds()
    }

    #[getter]
    fn num_threads(&self) -> usize {
        self.worlds.threads()
    }

    #[getter]
    fn spec<'py>(slf: &Bound<'_, Self>, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        own!(slf, this);
        build::describe(py, this.worlds.spec())
    }

    /// Begins an episode in each marked world; a seed first restarts their random streams. They begin at starts of their bank, or at
    /// the row of the world `like`, or at their own, with the parts of `state` in place of its own.
    #[pyo3(signature = (marks, observation, seed=None, like=None, state=None))]
    fn reset(
        slf: &Bound<'_, Self>,
        py: Python<'_>,
        marks: PyReadonlyArray1<'_, bool>,
        observation: &Bound<'_, PyArrayDyn<f32>>,
        seed: Option<u64>,
        like: Option<usize>,
        state: Option<Parts<'_>>,
    ) -> PyResult<()> {
        own_mut!(slf, this);
        let mut observation = writable(observation, "observation")?;
        let observation = observation.as_slice_mut().map_err(|_| not_contiguous("observation"))?;
        let marks = marks.as_slice().map_err(|_| not_contiguous("reset_mask"))?;
        let begin = |world: usize| -> PyResult<Begin> {
            match (marks.get(world), like, &state) {
                (Some(true), None, None) => Ok(Begin::AtStart),
                (Some(true), ..) => {
                    let mut row = this.copy_of(like.unwrap_or(world))?;
                    state.iter().try_for_each(|parts| set_parts(&mut row, parts, world))?;
                    Ok(Begin::AtRow(Box::new(row)))
                }
                _ => Ok(Begin::Stays),
            }
        };
        let mut begins = (0..this.worlds.worlds()).map(begin).collect::<PyResult<Vec<_>>>()?;
        let worlds = &mut this.worlds;
        let reset = || worlds.reset_worlds(|world| std::mem::take(&mut begins[world]), seed, observation);
        py.detach(|| guarded(reset))?.map_err(error)?;
        py.check_signals()
    }

    /// Lets the marked worlds continue exactly from another one's state.
    fn copy_world(
        slf: &Bound<'_, Self>,
        py: Python<'_>,
        world: usize,
        marks: PyReadonlyArray1<'_, bool>,
        observation: &Bound<'_, PyArrayDyn<f32>>,
    ) -> PyResult<()> {
        own_mut!(slf, this);
        let mut observation = writable(observation, "observation")?;
        let observation = observation.as_slice_mut().map_err(|_| not_contiguous("observation"))?;
        let marks = marks.as_slice().map_err(|_| not_contiguous("worlds"))?;
        let worlds = &mut this.worlds;
        py.detach(|| guarded(|| worlds.copy_world(world, marks, observation)))?.map_err(error)
    }

    /// Ends the episodes of the marked worlds.
    fn end_episodes(
        slf: &Bound<'_, Self>,
        py: Python<'_>,
        marks: PyReadonlyArray1<'_, bool>,
        observation: &Bound<'_, PyArrayDyn<f32>>,
    ) -> PyResult<()> {
        own_mut!(slf, this);
        let mut observation = writable(observation, "observation")?;
        let observation = observation.as_slice_mut().map_err(|_| not_contiguous("observation"))?;
        let marks = marks.as_slice().map_err(|_| not_contiguous("mask"))?;
        let worlds = &mut this.worlds;
        py.detach(|| guarded(|| worlds.end_episodes(marks, observation)))?.map_err(error)
    }

    /// Computes these sensors of the marked worlds' present rows again.
    fn look(
        slf: &Bound<'_, Self>,
        py: Python<'_>,
        sensors: Vec<String>,
        marks: PyReadonlyArray1<'_, bool>,
        observation: &Bound<'_, PyArrayDyn<f32>>,
    ) -> PyResult<()> {
        own_mut!(slf, this);
        let mut observation = writable(observation, "observation")?;
        let observation = observation.as_slice_mut().map_err(|_| not_contiguous("observation"))?;
        let marks = marks.as_slice().map_err(|_| not_contiguous("worlds"))?;
        let worlds = &mut this.worlds;
        py.detach(|| guarded(|| worlds.look(&sensors, marks, observation)))?.map_err(|failure| match failure {
            BatchError::Task { source, .. } => PyValueError::new_err(source.to_string()),
            failure => error(failure),
        })
    }

    /// The verdicts on each episode that the last step ended, with its world.
    fn verdicts<'py>(slf: &Bound<'_, Self>, py: Python<'py>) -> PyResult<Vec<(usize, Bound<'py, PyDict>)>> {
        own!(slf, this);
        let described = this.worlds.verdicts().map(|(world, verdicts)| {
            let dict = PyDict::new(py);
            describe_verdicts(&dict, &verdicts)?;
            Ok((world, dict))
        });
        described.collect()
    }

    /// Worlds whose next episode has not begun yet.
    fn ended(slf: &Bound<'_, Self>) -> PyResult<Vec<bool>> {
        own!(slf, this);
        guarded(|| this.worlds.ended())
    }

    /// Lets each world's present episode end this many steps earlier.
    fn shorten_episodes(slf: &Bound<'_, Self>, steps: Vec<u64>) -> PyResult<()> {
        own_mut!(slf, this);
        guarded(|| this.worlds.shorten_episodes(&steps))?.map_err(error)
    }

    /// Takes a control step in every world.
    fn step(
        slf: &Bound<'_, Self>,
        py: Python<'_>,
        actions: PyReadonlyArrayDyn<'_, f64>,
        observation: &Bound<'_, PyArrayDyn<f32>>,
        final_observation: Option<Bound<'_, PyArrayDyn<f32>>>,
        reward: &Bound<'_, PyArrayDyn<f32>>,
        reward_terms: Option<Bound<'_, PyArrayDyn<f32>>>,
        terminated: &Bound<'_, PyArrayDyn<bool>>,
        truncated: &Bound<'_, PyArrayDyn<bool>>,
        success: &Bound<'_, PyArrayDyn<bool>>,
    ) -> PyResult<()> {
        own_mut!(slf, this);
        let mut observation = writable(observation, "observation")?;
        let mut reward = writable(reward, "reward")?;
        let mut terminated = writable(terminated, "terminated")?;
        let mut truncated = writable(truncated, "truncated")?;
        let mut success = writable(success, "success")?;
        let mut final_observation =
            final_observation.as_ref().map(|array| writable(array, "final_observation")).transpose()?;
        let mut reward_terms = reward_terms.as_ref().map(|array| writable(array, "reward_terms")).transpose()?;
        fn optional<'a>(
            array: &'a mut Option<PyReadwriteArrayDyn<'_, f32>>,
            field: &str,
        ) -> PyResult<Option<&'a mut [f32]>> {
            let slice = array.as_mut().map(|array| array.as_slice_mut().map_err(|_| not_contiguous(field)));
            slice.transpose()
        }
        let actions = actions.as_slice().map_err(|_| not_contiguous("actions"))?;
        let mut buffers = Buffers {
            observation: observation.as_slice_mut().map_err(|_| not_contiguous("observation"))?,
            final_observation: optional(&mut final_observation, "final_observation")?,
            reward: reward.as_slice_mut().map_err(|_| not_contiguous("reward"))?,
            reward_terms: optional(&mut reward_terms, "reward_terms")?,
            terminated: terminated.as_slice_mut().map_err(|_| not_contiguous("terminated"))?,
            truncated: truncated.as_slice_mut().map_err(|_| not_contiguous("truncated"))?,
            success: success.as_slice_mut().map_err(|_| not_contiguous("success"))?,
        };
        let worlds = &mut this.worlds;
        // Ctrl-C is looked at when the step is done: no world may be a step ahead of another.
        py.detach(|| guarded(|| worlds.step(actions, &mut buffers)))?.map_err(error)
    }

    /// Takes a control step for each of `steps` lists of actions of all worlds, and writes the results of each; of observations those of the
    /// last step, or of each where there is room for all.
    fn rollout(
        slf: &Bound<'_, Self>,
        py: Python<'_>,
        steps: usize,
        actions: PyReadonlyArrayDyn<'_, f64>,
        observation: &Bound<'_, PyArrayDyn<f32>>,
        reward: &Bound<'_, PyArrayDyn<f32>>,
        reward_terms: &Bound<'_, PyArrayDyn<f32>>,
        terminated: &Bound<'_, PyArrayDyn<bool>>,
        truncated: &Bound<'_, PyArrayDyn<bool>>,
        success: &Bound<'_, PyArrayDyn<bool>>,
    ) -> PyResult<()> {
        own_mut!(slf, this);
        let mut observation = writable(observation, "observation")?;
        let mut reward = writable(reward, "reward")?;
        let mut reward_terms = writable(reward_terms, "reward_terms")?;
        let mut terminated = writable(terminated, "terminated")?;
        let mut truncated = writable(truncated, "truncated")?;
        let mut success = writable(success, "success")?;
        let actions = actions.as_slice().map_err(|_| not_contiguous("actions"))?;
        let observation = observation.as_slice_mut().map_err(|_| not_contiguous("observation"))?;
        let reward = reward.as_slice_mut().map_err(|_| not_contiguous("reward"))?;
        let terms = reward_terms.as_slice_mut().map_err(|_| not_contiguous("reward_terms"))?;
        let terminated = terminated.as_slice_mut().map_err(|_| not_contiguous("terminated"))?;
        let truncated = truncated.as_slice_mut().map_err(|_| not_contiguous("truncated"))?;
        let success = success.as_slice_mut().map_err(|_| not_contiguous("success"))?;
        let worlds = &mut this.worlds;
        let (count, spec) = (worlds.worlds(), worlds.spec());
        let (each, observed, paid) =
            (spec.actions.len() * count, spec.observation_length() * count, spec.rewards.len() * count);
        let keeps_all = observation.len() == steps * observed;
        let is_room = reward.len() == steps * count && terms.len() == steps * paid && actions.len() == steps * each;
        if !is_room || !(keeps_all || observation.len() == observed) {
            return Err(PyValueError::new_err("rollout: an array has another size than steps and worlds say"));
        }
        // A refused rollout takes no step.
        for actions in actions.chunks(each.max(1)) {
            worlds.check_actions(actions).map_err(error)?;
        }
        for step in 0..steps {
            let first = if keeps_all { step * observed } else { 0 };
            let mut buffers = Buffers {
                observation: &mut observation[first..first + observed],
                final_observation: None,
                reward: &mut reward[step * count..][..count],
                reward_terms: Some(&mut terms[step * paid..][..paid]),
                terminated: &mut terminated[step * count..][..count],
                truncated: &mut truncated[step * count..][..count],
                success: &mut success[step * count..][..count],
            };
            let actions = &actions[step * each..][..each];
            py.detach(|| guarded(|| worlds.step(actions, &mut buffers)))?.map_err(error)?;
            py.check_signals()?;
        }
        Ok(())
    }

    /// A picture of a world, RGB, as of `Episode.render`.
    #[pyo3(signature = (world, width, height, camera=None))]
    fn render<'py>(
        slf: &Bound<'py, Self>,
        py: Python<'py>,
        world: usize,
        width: usize,
        height: usize,
        camera: Option<&str>,
    ) -> PyResult<Bound<'py, PyBytes>> {
        own_mut!(slf, this);
        let (row, light) = (this.copy_of(world)?, this.worlds.light(world).map_err(error)?);
        let none = || error(BatchError::NoWorld { world, worlds: this.worlds.worlds() });
        let scene = Arc::clone(this.worlds.scene(world).ok_or_else(none)?);
        this.painter.paint(py, &scene, &row, &Lighting::of(&light), [width, height], camera)
    }

    /// The state of all worlds, or of one.
    #[pyo3(signature = (world=None))]
    fn save(slf: &Bound<'_, Self>, world: Option<usize>) -> PyResult<Snapshot> {
        own!(slf, this);
        this.saved(world)
    }

    /// Returns to a snapshot of all worlds, or lets the marked worlds continue from one of a single world.
    #[pyo3(signature = (snapshot, observation, marks=None))]
    fn restore(
        slf: &Bound<'_, Self>,
        py: Python<'_>,
        snapshot: &Snapshot,
        observation: &Bound<'_, PyArrayDyn<f32>>,
        marks: Option<PyReadonlyArray1<'_, bool>>,
    ) -> PyResult<()> {
        own_mut!(slf, this);
        let mut observation = writable(observation, "observation")?;
        let observation = observation.as_slice_mut().map_err(|_| not_contiguous("observation"))?;
        let marks = marks.as_ref().map(|marks| marks.as_slice().map_err(|_| not_contiguous("worlds"))).transpose()?;
        let worlds = &mut this.worlds;
        let restore = || match marks {
            Some(marks) => worlds.restore_worlds(&snapshot.0, marks, observation),
            None => worlds.restore(&snapshot.0, observation),
        };
        py.detach(|| guarded(restore))?.map_err(error)
    }

    /// The parts of a world's present row that a learner or a test reads.
    fn row<'py>(slf: &Bound<'_, Self>, py: Python<'py>, world: usize) -> PyResult<Bound<'py, PyDict>> {
        own!(slf, this);
        describe_row(py, &this.copy_of(world)?)
    }

    /// Contact points of the last step of all worlds: the shapes; and the world, distance, point, normal and force: 11 numbers each.
    fn contacts<'py>(slf: &Bound<'_, Self>, py: Python<'py>) -> PyResult<state::Contacts<'py>> {
        own!(slf, this);
        let (mut shapes, mut numbers) = (Vec::new(), Vec::new());
        for world in 0..this.worlds.worlds() {
            let Some(scene) = this.worlds.scene(world) else { continue };
            let contacts = this.worlds.contacts(world).map_err(error)?;
            state::describe_contacts(&scene.model, world, &contacts, &mut shapes, &mut numbers);
        }
        Ok((shapes, numbers.into_pyarray(py)))
    }

    /// Values drawn for each world's present episode, by name, and the seed of its room.
    fn drawn(slf: &Bound<'_, Self>) -> PyResult<Vec<(u64, Drawn)>> {
        own!(slf, this);
        let drawn = |world: usize| {
            let seed = this.worlds.scene(world).map_or(0, |scene| scene.spec.seed);
            this.worlds.drawn(world).map(|drawn| (seed, drawn)).map_err(error)
        };
        (0..this.worlds.worlds()).map(drawn).collect()
    }
}

impl Batch {
    pub(crate) fn worlds(&self) -> &Worlds {
        &self.worlds
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

    fn saved(&self, world: Option<usize>) -> PyResult<Snapshot> {
        let save = || world.map_or_else(|| self.worlds.save(), |world| self.worlds.save_world(world));
        guarded(save)?.map(Snapshot).map_err(error)
    }

    fn copy_of(&self, world: usize) -> PyResult<Row> {
        self.worlds.row(world).map_err(error)
    }
}
