//! One episode of the benchmark, with its sensors.

use std::sync::Arc;

use fiatlux_batch::{ActionForm, Rulebook, RulebookOptions, Spec, Task as _, Verdicts};
use fiatlux_mjcf::{MjcfOptions, Names, OptionSet, to_mjcf};
use fiatlux_play::{Command, Play, PlayError};
use fiatlux_render::{Lighting, Visuals};
use fiatlux_rules::Protocol;
use fiatlux_sensing::{Sampler, SenseError, SensorSuite, Sensors, Setup, View};
use fiatlux_world::{Episode as WorldEpisode, PHYSICS_DT, Scene, SceneConfig};
use numpy::{IntoPyArray, PyArray1, PyReadonlyArrayDyn, PyReadwriteArrayDyn};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict, PyTuple};

use crate::fault::{failed, guarded, not_contiguous, own, own_mut, refused};
use crate::painter::Painter;
use crate::settings::Settings;
use crate::state::{Contacts, describe_contacts, describe_row};
use crate::{bag, build};

/// One episode of the benchmark, with the same rows and digest as on a server.
#[pyclass(module = "fiatlux._native")]
pub(crate) struct Episode {
    /// Its settings as they were given, and the actions so far, for copies.
    settings: Py<PyDict>,
    played: Vec<f64>,
    play: Play,
    sampler: Sampler,
    /// The observation of the row `sampled_at`; parts that are not due are older.
    observation: Vec<f32>,
    sampled_at: Option<u64>,
    spec: Spec,
    form: ActionForm,
    /// Steps in which all criteria of the published gate held, up to the published end.
    steps_in_gate: u64,
    visuals: Option<Arc<Visuals>>,
    painter: Painter,
}

#[pymethods]
impl Episode {
    /// An episode at its start, or after these actions, in which sensors that are not computed in every step were computed last at
    /// the steps `taken_at`.
    #[new]
    #[pyo3(signature = (task, seed, episode, settings, actions=None, taken_at=Vec::new()))]
    fn new(
        py: Python<'_>,
        task: &str,
        seed: u64,
        episode: u64,
        settings: Bound<'_, PyDict>,
        actions: Option<PyReadonlyArrayDyn<'_, f64>>,
        taken_at: Vec<u64>,
    ) -> PyResult<Self> {
        let given = settings.copy()?.unbind();
        let settings: Settings = settings.extract()?;
        let task = build::task(task)?;
        let (robot, gains) = settings.robot()?;
        let options = settings.rulebook(task)?;
        let RulebookOptions { protocol, ref sensors, image_size, action_form: form, action_delay, .. } = options;
        let sampler = sensors.clone();
        let network = settings.network(sampler.sensors())?;
        let spec = settings.episode(task, seed, episode)?;
        let begin = || -> Result<_, Box<dyn std::error::Error + Send + Sync>> {
            let scene = Arc::new(Scene::build(&SceneConfig::default(), robot, spec.scene(gains))?);
            let episode = WorldEpisode::start(Arc::clone(&scene), &spec)?;
            let setup = Setup { protocol, image_size, ..Setup::new(&scene, task) };
            let suite = SensorSuite::new(sampler.sensors(), setup).with_sight(sampler.sight()).with_network(network);
            let mut visuals = None;
            let drawn = || Arc::clone(visuals.insert(Arc::new(Visuals::new(&scene))));
            let play = Play::start_with(episode, suite, action_delay[0], drawn)?;
            // The same names as in a batch, so that both kinds of environment have one form.
            let named = Rulebook::new(task, &scene, options, None)?.spec().clone();
            Ok((play, visuals, named))
        };
        let begun = py.detach(|| guarded(begin))?;
        let (play, visuals, spec) = begun.map_err(|error| refused(&*error))?;
        py.check_signals()?;
        let mut made = Self {
            settings: given,
            played: Vec::new(),
            play,
            observation: vec![0.0; spec.observation_length()],
            sampler,
            sampled_at: None,
            spec,
            form,
            steps_in_gate: 0,
            visuals,
            painter: Painter::default(),
        };
        if let Some(actions) = &actions {
            let actions = actions.as_slice().map_err(|_| not_contiguous("actions"))?;
            let last = (actions.len() / made.spec.actions.len().max(1)) as u64;
            made.sampler.set_taken_at(&taken_at, last).map_err(|error| refused(&error))?;
            let replay = || -> Result<(), PlayError> {
                made.retake()?;
                for action in actions.chunks(made.spec.actions.len()) {
                    made.advance(action)?;
                    made.retake()?;
                }
                Ok(())
            };
            py.detach(|| guarded(replay))?.map_err(|error| refused(&error))?;
        }
        Ok(made)
    }

    /// A pickle holds what was played, and plays it again.
    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyTuple>)> {
        let spec = self.episode().spec();
        let actions = PyArray1::from_slice(py, &self.played);
        let settings = self.settings.clone_ref(py);
        let taken_at = self.sampler.taken_at();
        let arguments =
            (spec.task.short_id(), spec.seed, spec.episode, settings, actions, taken_at).into_pyobject(py)?;
        Ok((py.get_type::<Self>().into_any(), arguments))
    }

    fn __deepcopy__(&self, py: Python<'_>, _memo: Bound<'_, PyAny>) -> Self {
        Self {
            settings: self.settings.clone_ref(py),
            played: self.played.clone(),
            play: self.play.clone(),
            sampler: self.sampler.clone(),
            observation: self.observation.clone(),
            spec: self.spec.clone(),
            visuals: self.visuals.clone(),
            painter: Painter::default(),
            ..*self
        }
    }

    #[getter]
    fn spec<'py>(slf: &Bound<'_, Self>, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        own!(slf, this);
        build::describe(py, &this.spec)
    }

    /// Writes the observation of the present row.
    fn observe(slf: &Bound<'_, Self>, mut observation: PyReadwriteArrayDyn<'_, f32>) -> PyResult<()> {
        own_mut!(slf, this);
        let observation = observation.as_slice_mut().map_err(|_| not_contiguous("observation"))?;
        let (expected, found) = (this.spec.observation_length(), observation.len());
        if found != expected {
            return Err(refused(&fiatlux_batch::BatchError::Length { field: "observation", found, expected }));
        }
        guarded(|| this.sample())?.map_err(|error| failed(&error))?;
        observation.copy_from_slice(&this.observation);
        Ok(())
    }

    /// Computes these sensors of the present row again.
    fn look(slf: &Bound<'_, Self>, py: Python<'_>, sensors: Vec<String>) -> PyResult<()> {
        own_mut!(slf, this);
        let asked = this.sampler.named(&sensors).map_err(|error| refused(&error))?;
        let look = || {
            this.sample()?;
            let (suite, view) = this.play.senses();
            this.sampler.look(suite, asked, &view, &mut this.observation)
        };
        py.detach(|| guarded(look))?.map_err(|error| failed(&error))
    }

    /// Takes a control step; returns reward, terminated, truncated.
    fn step(slf: &Bound<'_, Self>, py: Python<'_>, action: PyReadonlyArrayDyn<'_, f64>) -> PyResult<(f64, bool, bool)> {
        own_mut!(slf, this);
        let action = action.as_slice().map_err(|_| not_contiguous("action"))?;
        // What is due in a row is seen before the row is left.
        guarded(|| this.sample())?.map_err(|error| failed(&error))?;
        py.detach(|| guarded(|| this.advance(action)))?.map_err(|error| refused(&error))?;
        let end = this.episode().end();
        Ok((
            this.episode().reward(),
            end.is_some_and(|end| end.is_terminated()),
            end.is_some_and(|end| end.is_truncated()),
        ))
    }

    /// Value of each term of the reward in the last step.
    fn reward_terms<'py>(slf: &Bound<'_, Self>, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        own!(slf, this);
        let terms = PyDict::new(py);
        this.episode().terms().iter().try_for_each(|term| terms.set_item(term.name, term.reward))?;
        Ok(terms)
    }

    /// Digest of the rows so far, hexadecimal.
    #[getter]
    fn digest(&self) -> String {
        self.episode().digest().hex()
    }

    /// Domain sample of the episode, as the header of its bag has it.
    fn drawn<'py>(slf: &Bound<'_, Self>, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        own!(slf, this);
        bag::described(py, &fiatlux_wire::domain_sample_message(&this.episode().domain_sample()))
    }

    /// Summary of the episode so far: the fields of `results.json` that follow from its rows.
    fn summary<'py>(slf: &Bound<'_, Self>, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        own!(slf, this);
        let spec = this.episode().spec();
        let dict = PyDict::new(py);
        dict.set_item("task", spec.task.short_id())?;
        dict.set_item("seed", spec.seed)?;
        dict.set_item("episode", spec.episode)?;
        describe_verdicts(&dict, &Verdicts::of(this.episode().judges()))?;
        dict.set_item("steps_in_gate", this.steps_in_gate)?;
        dict.set_item("state_digest", this.digest())?;
        Ok(dict)
    }

    /// The parts of the present row that a learner or a test reads.
    fn row<'py>(slf: &Bound<'_, Self>, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        own!(slf, this);
        describe_row(py, this.episode().row())
    }

    /// Contact points of the last physics step, as of [`Batch::contacts`](crate::batch::Batch).
    fn contacts<'py>(&self, py: Python<'py>) -> Contacts<'py> {
        let (mut shapes, mut numbers) = (Vec::new(), Vec::new());
        let contacts = self.episode().world().dynamics().contacts();
        describe_contacts(&self.episode().scene().model, 0, contacts, &mut shapes, &mut numbers);
        (shapes, numbers.into_pyarray(py))
    }

    /// The scene as MJCF for MuJoCo; its keyframe `start` is the present state with the present targets.
    fn mjcf(slf: &Bound<'_, Self>, nearest: bool) -> PyResult<String> {
        own!(slf, this);
        let (scene, row) = (this.episode().scene(), this.episode().row());
        let mut targets = vec![0.0; scene.model.drives().len()];
        for (ids, target) in scene.robot_ids.joints.iter().zip(&row.joint_target) {
            targets[ids.drive] = *target;
        }
        let options = MjcfOptions {
            name: this.episode().spec().task.short_id().into(),
            timestep: PHYSICS_DT,
            option_set: if nearest { OptionSet::Nearest } else { OptionSet::Defaults },
            names: Names::of_scene(scene),
        };
        guarded(|| to_mjcf(&scene.model, this.episode().world().state(), &targets, &options))
    }

    /// A picture for display, RGB, row by row from the top: from the robot's side, or from one of its cameras.
    #[pyo3(signature = (width, height, camera=None))]
    fn render<'py>(
        slf: &Bound<'py, Self>,
        py: Python<'py>,
        width: usize,
        height: usize,
        camera: Option<&str>,
    ) -> PyResult<Bound<'py, PyBytes>> {
        own_mut!(slf, this);
        let scene = Arc::clone(this.episode().scene());
        let light = Lighting::of(&this.episode().spec().light());
        if let Some(visuals) = &this.visuals {
            this.painter.share(&scene, visuals);
        }
        this.painter.paint(py, &scene, this.play.episode().row(), &light, [width, height], camera)
    }
}

impl Episode {
    fn episode(&self) -> &WorldEpisode {
        self.play.episode()
    }

    /// The sensors, and the present row.
    pub(crate) fn senses(&mut self) -> (&mut SensorSuite, View<'_>) {
        self.play.senses()
    }

    /// Samples the present row, once.
    fn sample(&mut self) -> Result<(), SenseError> {
        let step = Some(self.episode().row().step);
        if self.sampled_at != step {
            let (suite, view) = self.play.senses();
            self.sampler.sample(suite, &view, &mut self.observation)?;
            self.sampled_at = step;
        }
        Ok(())
    }

    /// Computes the sensors that were computed last in the present row, in an episode that is played again.
    fn retake(&mut self) -> Result<(), SenseError> {
        let asked = self.sampler.taken_in(self.episode().row().step);
        if asked == Sensors::NONE {
            return Ok(());
        }
        let (suite, view) = self.play.senses();
        self.sampler.look(suite, asked, &view, &mut self.observation)
    }

    /// Takes a control step; if it is refused, nothing changes.
    fn advance(&mut self, action: &[f64]) -> Result<(), PlayError> {
        let counts = self.episode().judges().of(Protocol::Published).verdict().end.is_none();
        let command = match self.form {
            ActionForm::Action => Command::Action(action.to_vec()),
            ActionForm::JointTarget => Command::JointTarget(action.to_vec()),
        };
        self.play.step(&command)?;
        let holds = self.episode().judges().of(Protocol::Published).verdict().criteria.all();
        self.steps_in_gate += u64::from(counts && holds);
        self.played.extend_from_slice(action);
        Ok(())
    }
}

/// Adds the verdicts of an episode's judges: plain names are of the published one, those with `strict_` of the strict one, `None` if
/// the protocol is published.
pub(crate) fn describe_verdicts(dict: &Bound<'_, PyDict>, verdicts: &Verdicts) -> PyResult<()> {
    let Verdicts { published: summary, strict, end } = *verdicts;
    dict.set_item("success", summary.success)?;
    dict.set_item("clean", summary.clean())?;
    dict.set_item("broken", summary.broken)?;
    dict.set_item("dropped", summary.dropped)?;
    dict.set_item("gate_progress", summary.gate_progress)?;
    dict.set_item("peak_hand_force_n", summary.peak_hand_force_n)?;
    dict.set_item("control_effort", summary.control_effort)?;
    dict.set_item("steps", summary.steps)?;
    dict.set_item("end", end.map(|end| end.cause().name()))?;
    let causes = end.map_or_else(Vec::new, |end| end.causes.iter().map(|cause| cause.name()).collect());
    dict.set_item("causes", causes)?;
    dict.set_item("strict_success", strict.map(|strict| strict.success))?;
    dict.set_item("strict_clean", strict.map(|strict| strict.clean()))?;
    dict.set_item("strict_progress", strict.map(|strict| strict.gate_progress))?;
    dict.set_item("strict_end", strict.and_then(|strict| strict.end).map(|end| end.cause().name()))?;
    dict.set_item("strict_steps", strict.map(|strict| strict.steps))?;
    Ok(())
}
