//! Batches that read and write NumPy arrays.

mod error;
mod kinds;

use std::collections::BTreeMap;
use std::sync::Arc;

use fiatlux_batch::{
    Batch as Worlds, BatchError, Begin, Buffers, ClimbingOptions, Drawn, Snapshot as Saved, WalkingOptions,
};
use fiatlux_render::Lighting;
use fiatlux_rules::Row;
use numpy::{IntoPyArray, PyArrayDyn, PyArrayMethods, PyReadonlyArray1, PyReadonlyArrayDyn, PyReadwriteArrayDyn};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict, PyTuple};

use crate::build;
use crate::episode::describe_verdicts;
use crate::fault::{guarded, not_contiguous, own, own_mut};
use crate::painter::Painter;
use crate::state::{self, Parts, describe_row, set_parts};

pub(crate) use error::error;

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

/// An array to write to. It is borrowed after the batch is, so that a second thread hears of the batch.
fn writable<'py, T: numpy::Element>(
    array: &Bound<'py, PyArrayDyn<T>>,
    field: &str,
) -> PyResult<PyReadwriteArrayDyn<'py, T>> {
    array.try_readwrite().map_err(|error| PyValueError::new_err(format!("{field}: {error}")))
}

#[pymethods]
impl Batch {
    /// Worlds of a kind, which continue from a snapshot if there is one. The arguments of `rulebook` are a task, starts, and two
    /// dictionaries of settings; those of `walking` are the dictionaries.
    #[new]
    #[pyo3(signature = (kind, arguments, snapshot=None))]
    fn new(kind: &str, arguments: Bound<'_, PyTuple>, snapshot: Option<&Snapshot>) -> PyResult<Self> {
        let mut worlds = kinds::made(kind, &arguments)?;
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

    fn saved(&self, world: Option<usize>) -> PyResult<Snapshot> {
        let save = || world.map_or_else(|| self.worlds.save(), |world| self.worlds.save_world(world));
        guarded(save)?.map(Snapshot).map_err(error)
    }

    fn copy_of(&self, world: usize) -> PyResult<Row> {
        self.worlds.row(world).map_err(error)
    }
}
