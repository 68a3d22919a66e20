//! Gives learners the experts: what the policy `expert` would do in a world as it is now.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

use fiatlux_batch::{Batch as Worlds, BatchError};
use fiatlux_cli::in_full;
use fiatlux_client::{Policy, PolicyError};
use fiatlux_policies::{Expert as Asked, Label};
use fiatlux_proto::v3::{Observation, Sensor as Asks, SessionInfo};
use fiatlux_rules::CONTROL_DT;
use fiatlux_sensing::{SenseError, Sensor, SensorSuite, Sensors, View};
use fiatlux_wire::session_terms;
use fiatlux_world::ACTION_SCALE;
use numpy::{PyReadonlyArrayDyn, PyReadwriteArrayDyn};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::batch::{Batch, error};
use crate::episode::Episode;
use crate::fault::{failed, guarded, not_contiguous, own, own_mut};

/// The sensors of experts. A learner's own sensors do not matter.
pub(crate) const SENSORS: Sensors =
    Sensors::of(&[Sensor::Proprioception, Sensor::HandContact, Sensor::LastAction, Sensor::Privileged]);

/// The expert of one world, and its last answer.
struct Teacher {
    expert: Asked,
    /// Episode and step of the last answer.
    at: Option<(u64, u64)>,
    answer: Result<Label, String>,
    q0: Vec<f64>,
    /// Its parameters are not its own.
    is_changed: bool,
    /// Why it cannot be asked at all.
    refused: Option<String>,
}

/// An answer's numbers that are not in arrays: phase, part of the plan that is done, and why there is no answer.
type Told = (String, f64, Option<String>);

impl Teacher {
    /// An expert with parameters in place of those of the file of its task by hand.
    fn new(parameters: Option<&str>) -> PyResult<Self> {
        let (is_changed, refused) = (parameters.is_some(), None);
        let expert = Asked::with_parameters(parameters.map(str::to_string)).map_err(|error| failed(&error))?;
        Ok(Self { expert, at: None, answer: Err(String::new()), q0: Vec::new(), is_changed, refused })
    }

    /// Answers the present row once. A new episode, or an earlier row, makes the expert begin anew there.
    fn ask(&mut self, suite: &mut SensorSuite, view: &View<'_>) -> Result<(), SenseError> {
        let now = (view.episode, view.row.step);
        if self.at == Some(now) {
            return Ok(());
        }
        let seen = suite.observe(view, SENSORS)?;
        self.hear(&seen, now, || session_terms(view.task, view.scene));
        Ok(())
    }

    /// Answers an observation of an episode and a step once, as [`Teacher::ask`] does.
    fn hear(&mut self, seen: &Observation, now: (u64, u64), info: impl FnOnce() -> SessionInfo) {
        if self.at == Some(now) {
            return;
        }
        let goes_on = self.at.is_some_and(|(episode, step)| episode == now.0 && step < now.1);
        if !goes_on {
            let info = info();
            self.q0 = info.joints.iter().map(|joint| joint.q0).collect();
            self.answer = Ok(Label::default());
            if let Err(error) = self.expert.reset(&info, seen) {
                self.answer = Err(in_full(&error));
                let is_unfit = matches!(error, PolicyError::Unfit { .. });
                self.refused = (self.is_changed && !is_unfit).then(|| in_full(&error));
            } else if self.is_changed && !self.expert.is_by_hand() {
                self.refused =
                    Some(format!("{} is not played by hand: it has none", info.task.unwrap_or_default().task));
            }
        }
        // An expert that could not go on begins anew only with an episode, or when it is told to.
        if self.answer.is_ok() {
            self.answer = self.expert.label(seen).map_err(|error| in_full(&error));
        }
        self.at = Some(now);
    }

    /// Writes the last answer into a row: joint targets, the same as actions, the command, and the flags `is_over` and `can_label`.
    fn write(&self, row: &mut [f64]) -> Told {
        row.fill(f64::NAN);
        let [numbers @ .., is_over, can_label] = row else { return (String::new(), f64::NAN, None) };
        (*is_over, *can_label) = (0.0, 0.0);
        let label = match &self.answer {
            Err(reason) => return (String::new(), f64::NAN, Some(reason.clone())),
            Ok(label) => label,
        };
        let (targets, rest) = numbers.split_at_mut(label.joint_target.len());
        let (actions, command) = rest.split_at_mut(targets.len());
        targets.copy_from_slice(&label.joint_target);
        for ((action, target), q0) in actions.iter_mut().zip(&*targets).zip(&self.q0) {
            *action = (target - q0) / ACTION_SCALE;
        }
        if let Some(body) = &label.body_command {
            command.iter_mut().zip(body.numbers()).for_each(|(place, number)| *place = number);
        }
        (*is_over, *can_label) = (f64::from(u8::from(label.is_over)), 1.0);
        (label.phase.clone(), label.part_done.unwrap_or(f64::NAN), None)
    }
}

/// Writes the last answers of experts into an array, a row each, and returns what is not in it.
fn write<'a>(
    teachers: impl ExactSizeIterator<Item = &'a Mutex<Teacher>>,
    answers: &mut PyReadwriteArrayDyn<'_, f64>,
) -> PyResult<Vec<Told>> {
    let answers = answers.as_slice_mut().map_err(|_| not_contiguous("answers"))?;
    let width = (answers.len() / teachers.len().max(1)).max(1);
    let rows = answers.chunks_mut(width);
    let told = teachers.zip(rows).map(|(teacher, row)| {
        let teacher = lock(teacher);
        let refused = teacher.refused.as_ref().map(|why| PyValueError::new_err(format!("parameters: {why}")));
        refused.map_or_else(|| Ok(teacher.write(row)), Err)
    });
    told.collect()
}

/// The expert of one environment.
#[pyclass(module = "fiatlux._native")]
pub(crate) struct Expert(Mutex<Teacher>);

#[pymethods]
impl Expert {
    #[new]
    #[pyo3(signature = (parameters=None))]
    fn new(parameters: Option<&str>) -> PyResult<Self> {
        Ok(Self(Mutex::new(Teacher::new(parameters)?)))
    }

    /// Begins anew at the next row that it is asked about.
    fn restart(slf: &Bound<'_, Self>) -> PyResult<()> {
        own_mut!(slf, this);
        lock(&this.0).at = None;
        Ok(())
    }

    /// Answers an episode's present row; the array is as of `Experts::label`, of one row.
    fn label(
        slf: &Bound<'_, Self>,
        py: Python<'_>,
        episode: &Bound<'_, Episode>,
        mut answers: PyReadwriteArrayDyn<'_, f64>,
    ) -> PyResult<Vec<Told>> {
        own_mut!(slf, this);
        own_mut!(episode, episode);
        let asked = py.detach(|| {
            let (suite, view) = episode.senses();
            guarded(|| lock(&this.0).ask(suite, &view))
        });
        asked?.map_err(|error| failed(&error))?;
        write(std::iter::once(&this.0), &mut answers)
    }
}

/// The expert of a session, which answers what its server showed last.
#[pyclass(module = "fiatlux._native", frozen)]
pub(crate) struct SessionExpert {
    info: SessionInfo,
    /// Its policy acts by joint targets.
    is_target: bool,
    /// Sensors that the session does not show in each observation.
    lacks: Vec<&'static str>,
    seen: Mutex<Observation>,
    teacher: Mutex<Teacher>,
}

impl SessionExpert {
    pub fn new(info: &SessionInfo, is_target: bool) -> PyResult<Self> {
        let is_shown = |sensor: &Sensor| {
            let shown = |asked: &Asks| asked.name == sensor.name() && !asked.on_request && !asked.bag_only;
            let each = |asked: &Asks| asked.rate_hz == 0.0 || asked.rate_hz * CONTROL_DT > 0.99;
            info.sensors.iter().any(|asked| shown(asked) && each(asked))
        };
        let lacks = SENSORS.iter().filter(|sensor| !is_shown(sensor)).map(Sensor::name).collect();
        let (info, seen) = (info.clone(), Mutex::default());
        Ok(Self { info, is_target, lacks, seen, teacher: Mutex::new(Teacher::new(None)?) })
    }

    /// Keeps of an observation what the expert reads.
    pub fn show(&self, observation: &Observation) {
        if self.lacks.is_empty() {
            *lock(&self.seen) = Observation {
                episode: observation.episode,
                step: observation.step,
                proprioception: observation.proprioception.clone(),
                hand_contact_force: observation.hand_contact_force.clone(),
                last_action: observation.last_action.clone(),
                privileged: observation.privileged.clone(),
                ..Observation::default()
            };
        }
    }
}

#[pymethods]
impl SessionExpert {
    #[getter]
    fn lacks(&self) -> Vec<&'static str> {
        self.lacks.clone()
    }

    #[getter]
    fn is_target(&self) -> bool {
        self.is_target
    }

    /// Begins anew at the next observation that it is asked about.
    fn restart(&self) {
        lock(&self.teacher).at = None;
    }

    /// Answers the last observation; the array is as of `Experts::label`, of one row.
    fn label(&self, py: Python<'_>, mut answers: PyReadwriteArrayDyn<'_, f64>) -> PyResult<Vec<Told>> {
        py.detach(|| {
            guarded(|| {
                let seen = lock(&self.seen);
                lock(&self.teacher).hear(&seen, (seen.episode, seen.step), || self.info.clone());
            })
        })?;
        write(std::iter::once(&self.teacher), &mut answers)
    }
}

/// The experts of many worlds.
#[pyclass(module = "fiatlux._native")]
pub(crate) struct Experts {
    teachers: Vec<Mutex<Teacher>>,
    threads: usize,
}

#[pymethods]
impl Experts {
    #[new]
    #[pyo3(signature = (worlds, threads, parameters=None))]
    fn new(worlds: usize, threads: usize, parameters: Option<&str>) -> PyResult<Self> {
        let teachers: PyResult<_> = (0..worlds).map(|_| Teacher::new(parameters).map(Mutex::new)).collect();
        Ok(Self { teachers: teachers?, threads })
    }

    /// The experts of the marked worlds begin anew at the next rows that they are asked about.
    fn restart(slf: &Bound<'_, Self>, marks: PyReadonlyArrayDyn<'_, bool>) -> PyResult<()> {
        own!(slf, this);
        let marks = marks.as_slice().map_err(|_| not_contiguous("mask"))?;
        this.teachers.iter().zip(marks).filter(|(_, mark)| **mark).for_each(|(teacher, _)| lock(teacher).at = None);
        Ok(())
    }

    /// Answers the present rows of all worlds. In an array of worlds x (twice the joints + 9): joint targets, actions, the seven numbers
    /// of the command, and the flags `is_over` and `can_label`. Numbers that an answer lacks are NaN.
    fn label(
        slf: &Bound<'_, Self>,
        py: Python<'_>,
        batch: &Bound<'_, Batch>,
        mut answers: PyReadwriteArrayDyn<'_, f64>,
    ) -> PyResult<Vec<Told>> {
        own_mut!(slf, this);
        own!(batch, batch);
        py.detach(|| guarded(|| this.ask(batch.worlds())))?.map_err(error)?;
        write(this.teachers.iter(), &mut answers)
    }
}

impl Experts {
    /// Asks all experts, each thread the next world that no other has taken.
    fn ask(&self, worlds: &Worlds) -> Result<(), BatchError> {
        let next = AtomicUsize::new(0);
        let work = || {
            loop {
                let world = next.fetch_add(1, Ordering::Relaxed);
                let Some(teacher) = self.teachers.get(world) else { return Ok(()) };
                let asked = worlds.sense(world, |suite, view| lock(teacher).ask(suite, view))?;
                asked.map_err(|source| BatchError::Task { world, source: source.into() })?;
            }
        };
        std::thread::scope(|scope| {
            let helpers: Vec<_> = (1..self.threads.min(self.teachers.len())).map(|_| scope.spawn(work)).collect();
            let mut done = vec![work()];
            done.extend(
                helpers
                    .into_iter()
                    .map(|helper| helper.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))),
            );
            done.into_iter().collect()
        })
    }
}

fn lock<T>(shared: &Mutex<T>) -> MutexGuard<'_, T> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}
