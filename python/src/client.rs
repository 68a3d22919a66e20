//! Plays Python policies over Zenoh: one episode at a time, or a whole run.

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use fiatlux_access::PublicKey;
use fiatlux_batch::ActionForm;
use fiatlux_carrier::Carrier;
use fiatlux_cli::in_full;
use fiatlux_client::{
    Access, AccessArgs, Client as Session, Command, EpisodeFate, Policy, PolicyError, RunFile, RunOptions, RunOutcome,
    RunProgress, Shard,
};
use fiatlux_link::{CarrierArgs, Role};
use fiatlux_policies::Expert;
use fiatlux_proto::v3::{Observation, ObservationTerm, OpenRequest, RunSpec, Sensor, SessionInfo};
use fiatlux_rules::{Guest, NotAGuest, Relay, Task};
use fiatlux_sensing::Sensor as Known;
use numpy::{PyArray1, PyReadonlyArray1};
use pyo3::exceptions::{PyConnectionError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::build;
use crate::fault::{check_process, failed, not_contiguous, refused};
use crate::numbers::Numbers;
use crate::settings::Settings;
use crate::teacher::SessionExpert;
use crate::watch::watch;

/// A link to one server or several.
#[pyclass(module = "fiatlux._native", frozen)]
pub(crate) struct Client {
    link: Carrier,
    access: Access,
}

#[pymethods]
impl Client {
    #[new]
    fn open(
        py: Python<'_>,
        endpoints: Vec<String>,
        config: Option<PathBuf>,
        token: Option<PathBuf>,
        server_key: Option<&str>,
        known_servers: Option<PathBuf>,
    ) -> PyResult<Self> {
        check_process()?;
        let server_key = server_key.map(str::parse::<PublicKey>).transpose();
        let server_key = server_key.map_err(|error| PyValueError::new_err(format!("server_key: {error}")))?;
        let access = AccessArgs { server_key, known_servers, token }.read().map_err(|error| refused(&error))?;
        for endpoint in &endpoints {
            fiatlux_link::parse_endpoint(endpoint)
                .map_err(|reason| PyValueError::new_err(format!("endpoint: {reason}")))?;
        }
        // One of several servers may be down at the start.
        let role = if endpoints.len() > 1 { Role::Server } else { Role::Client };
        let args = CarrierArgs { connect: endpoints, config, ..CarrierArgs::default() };
        let link = watch(py, move |_, _| args.open(role), |_, ()| Ok(()))?;
        let link = link.map_err(|error| {
            // The messages name the programs' flag.
            let reason = in_full(&error).replace("Name another with -e tcp/HOST:PORT", "Pass another endpoint");
            PyConnectionError::new_err(format!("endpoint: {reason}"))
        })?;
        Ok(Self { link: link.carrier(), access })
    }

    /// Plays an episode in a session of its own; returns how it ended, with the fields of `EpisodeEnd`.
    fn run(
        &self,
        py: Python<'_>,
        player: Py<PyAny>,
        name: String,
        server: Option<String>,
        task: &str,
        seed: u64,
        episode: u64,
        settings: Settings,
        record: Vec<String>,
    ) -> PyResult<Py<PyDict>> {
        check_process()?;
        let request = OpenRequest {
            policy: name.clone(),
            task: build::task(task)?.to_string(),
            seed,
            recorded: !record.is_empty(),
            ..settings.request(&record)?
        };
        let form = settings.action_form()?;
        let (link, access, failure) = (self.link.clone(), self.access.clone(), Failure::default());
        let noted = failure.clone();
        let played = watch(
            py,
            move |stop, _| {
                let mut policy = Player::new(player, name, form, Failure { stop: Arc::clone(stop), ..noted });
                let mut client = Session::open_with(&link, server.as_deref(), request, &access)?;
                let end = client.run_episode(episode, &mut policy, &mut |_| (), stop);
                // A server would wait for a client that does not close its session.
                let _ = client.close();
                end
            },
            |_, ()| Ok(()),
        )?;
        failure.check()?;
        let end = played.map_err(|error| failed(&error))?;
        let dict = PyDict::new(py);
        dict.set_item("end", &end.cause)?;
        dict.set_item("causes", &end.causes)?;
        dict.set_item("steps", end.steps)?;
        dict.set_item("success", end.success)?;
        dict.set_item("gate_progress", end.gate_progress)?;
        dict.set_item("broken", end.broken)?;
        dict.set_item("dropped", end.dropped)?;
        dict.set_item("state_digest", &end.digest)?;
        Ok(dict.unbind())
    }

    /// Plays a whole run, or what is left of it.
    fn evaluate(
        &self,
        py: Python<'_>,
        make_player: Py<PyAny>,
        run: Run,
        settings: Settings,
        progress: Option<Py<PyAny>>,
    ) -> PyResult<Py<PyDict>> {
        check_process()?;
        let form = settings.action_form()?;
        let part = run.part(&settings)?;
        let options = RunOptions { access: self.access.clone(), ..run.options(&settings)? };
        let (link, failure) = (self.link.clone(), Failure::default());
        let noted = failure.clone();
        let played = watch(
            py,
            move |stop, tell| {
                let failure = Failure { stop: Arc::clone(stop), ..noted };
                play(&link, &options, make_player, part, form, &failure, &mut |progress| tell(progress.clone()))
            },
            |py, step| tell(py, progress.as_ref(), &step),
        )?;
        failure.check()?;
        describe(py, &played.map_err(|error| failed(&error))?)
    }
}

impl Drop for Client {
    fn drop(&mut self) {
        // In a forked child the link's threads do not exist, and closing it would wait for them.
        if check_process().is_err() {
            std::mem::forget(self.link.clone());
        }
    }
}

/// A run, without the settings of its sessions.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct Run {
    pub name: String,
    pub digest: String,
    pub version: String,
    pub link: String,
    pub tasks: Vec<String>,
    pub seeds: Vec<u64>,
    pub hosted_seeds: u32,
    pub server: Option<String>,
    pub parallel: Option<usize>,
    pub run_file: PathBuf,
    pub record: Vec<String>,
    pub patience_s: f64,
    pub shard: Option<String>,
    pub part: Option<String>,
}

/// The subtask of the errand that a Python policy plays, and the sensors that it asks for. The expert plays all else.
#[derive(Clone)]
pub(crate) struct Part {
    task: Task,
    sensors: Vec<Sensor>,
}

impl Run {
    /// The part of the errand that the policy plays, if it plays a part of it.
    pub(crate) fn part(&self, settings: &Settings) -> PyResult<Option<Part>> {
        let Some(name) = &self.part else { return Ok(None) };
        let guest: Result<Guest, NotAGuest> = format!("{name}={}", self.name).parse();
        let guest = guest.map_err(|_| PyValueError::new_err(format!("part is {name:?}; name one of S01 to S12")))?;
        Ok(Some(Part { task: guest.task, sensors: settings.request(&self.record)?.sensors }))
    }

    /// The part of its episodes to play.
    pub(crate) fn shard(&self) -> PyResult<Option<Shard>> {
        let shard = self.shard.as_deref().map(str::parse::<Shard>).transpose();
        shard.map_err(|error| PyValueError::new_err(format!("shard: {error}")))
    }

    /// Opens the run's file, or draws a new run.
    pub(crate) fn options(&self, settings: &Settings) -> PyResult<RunOptions> {
        if self.parallel == Some(0) {
            return Err(PyValueError::new_err("parallel is 0; at least 1 episode is played at once"));
        }
        let patience = Duration::try_from_secs_f64(self.patience_s)
            .map_err(|_| PyValueError::new_err(format!("patience_s is {}; give seconds", self.patience_s)))?;
        let tasks = self.tasks.iter().map(|name| Ok(build::task(name)?.to_string())).collect::<PyResult<_>>()?;
        let (mut policy, mut session) = (self.name.clone(), settings.request(&self.record)?);
        if let Some(Part { task, sensors }) = self.part(settings)? {
            session.sensors = Expert::new().map_err(|error| failed(&error))?.sensors_with(sensors);
            policy = Relay { host: "expert".into(), guests: vec![Guest { task, policy }] }.to_string();
        }
        let spec = RunSpec {
            policy,
            policy_version: self.version.clone(),
            policy_link: self.link.clone(),
            session: Some(session),
            tasks,
            seeds: self.seeds.clone(),
            hosted_seeds: self.hosted_seeds,
            ..RunSpec::default()
        };
        let file = RunFile::open_of(&self.run_file, &spec, &self.digest).map_err(|error| {
            // The messages name the programs' flag.
            PyValueError::new_err(in_full(&error).replace("--run-file", "run_file"))
        })?;
        let (server, shard) = (self.server.clone(), self.shard()?);
        Ok(RunOptions { server, parallel: self.parallel, patience, shard, ..RunOptions::new(file) })
    }
}

/// Plays a run, with a Python player for each episode.
pub(crate) fn play(
    link: &Carrier,
    options: &RunOptions,
    make_player: Py<PyAny>,
    part: Option<Part>,
    form: ActionForm,
    failure: &Failure,
    progress: &mut dyn FnMut(&RunProgress),
) -> Result<RunOutcome, fiatlux_client::RunError> {
    let name = options.file.spec.policy.clone();
    let make_policy = || {
        let player = Python::attach(|py| make_player.call0(py)).map_err(|error| failure.note(error))?;
        let mut player = Player::new(player, name.clone(), form, failure.clone());
        let Some(Part { task, sensors }) = part.clone() else { return Ok(Box::new(player) as Box<dyn Policy>) };
        player.sensors = sensors;
        Ok(Box::new(Expert::new()?.with(vec![(task, Box::new(player))])?) as Box<dyn Policy>)
    };
    Session::evaluate(link, options, make_policy, progress, &failure.stop)
}

pub(crate) fn tell(py: Python<'_>, progress: Option<&Py<PyAny>>, step: &RunProgress) -> PyResult<()> {
    let Some(progress) = progress else { return Ok(()) };
    let dict = PyDict::new(py);
    dict.set_item("episodes", step.episodes)?;
    dict.set_item("done", step.done)?;
    dict.set_item("successes", step.successes)?;
    dict.set_item("lost", step.lost)?;
    dict.set_item("steps", step.steps)?;
    dict.set_item("steps_left", step.steps_left)?;
    progress.call1(py, (dict,)).map(|_| ())
}

fn describe(py: Python<'_>, outcome: &RunOutcome) -> PyResult<Py<PyDict>> {
    let dict = PyDict::new(py);
    let mut episodes = Vec::new();
    for episode in &outcome.episodes {
        let row = PyDict::new(py);
        row.set_item("task", &episode.task)?;
        row.set_item("seed", episode.seed)?;
        let fate = match episode.fate {
            EpisodeFate::Played => "played",
            EpisodeFate::Failed => "failed",
            EpisodeFate::Lost => "lost",
        };
        row.set_item("fate", fate)?;
        row.set_item("end", &episode.cause)?;
        row.set_item("success", episode.success)?;
        row.set_item("state_digest", &episode.digest)?;
        row.set_item("attempts", episode.attempts)?;
        row.set_item("server", &episode.server)?;
        episodes.push(row);
    }
    dict.set_item("run", &outcome.run)?;
    dict.set_item("finished", outcome.finished)?;
    dict.set_item("protocol", &outcome.protocol)?;
    dict.set_item("servers", &outcome.servers)?;
    dict.set_item("episodes", episodes)?;
    Ok(dict.unbind())
}

/// The exception that a policy raised, kept for the caller; it stops everything.
#[derive(Clone, Default)]
pub(crate) struct Failure {
    /// An exception loses its own episode alone.
    pub goes_on: bool,
    pub error: Arc<Mutex<Option<PyErr>>>,
    pub stop: Arc<AtomicBool>,
}

impl Failure {
    fn note(&self, error: PyErr) -> PolicyError {
        // Not `Unfit`, by which a policy refuses a task: that ends the run as a failure, and here the same call goes on later.
        let failed = PolicyError::Failed { policy: "of Python", source: error.to_string().into() };
        if self.goes_on {
            return failed;
        }
        // The first exception causes the others.
        self.error.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(error);
        self.stop.store(true, Ordering::Relaxed);
        failed
    }

    /// Raises the exception, if there is one.
    pub(crate) fn check(&self) -> PyResult<()> {
        self.error.lock().unwrap_or_else(PoisonError::into_inner).take().map_or(Ok(()), Err)
    }
}

/// A Python policy: an object with `begin(info)`, `look(numbers)` and `act(numbers)`, where the numbers are the observation's terms one
/// after another.
struct Player {
    object: Py<PyAny>,
    name: String,
    form: ActionForm,
    failure: Failure,
    numbers: Numbers,
    /// The expert of the episode, which it may ask.
    expert: Option<Py<SessionExpert>>,
    /// Sensors that it asks for where it plays a part of the errand; elsewhere those of its sessions are in their request.
    sensors: Vec<Sensor>,
    /// Sensors that are seen when the policy looks.
    on_request: Vec<&'static str>,
    /// It could not say where to look.
    is_lost: bool,
}

impl Player {
    fn new(object: Py<PyAny>, name: String, form: ActionForm, failure: Failure) -> Self {
        let (numbers, sensors, on_request) = (Numbers::default(), Vec::new(), Vec::new());
        Self { object, name, form, failure, numbers, expert: None, sensors, on_request, is_lost: false }
    }

    fn begin(&mut self, info: &SessionInfo, first: &Observation, py: Python<'_>) -> PyResult<()> {
        let dict = PyDict::new(py);
        let expert = Py::new(py, SessionExpert::new(info, self.form == ActionForm::JointTarget)?)?;
        expert.get().show(first);
        dict.set_item("expert", &expert)?;
        self.expert = Some(expert);
        if let Some(task) = &info.task {
            dict.set_item("task", &task.task)?;
            dict.set_item("instruction", &task.instruction)?;
        }
        dict.set_item("seed", info.seed)?;
        dict.set_item("episode", first.episode)?;
        let spec = PyDict::new(py);
        let names: Vec<&str> = info.joints.iter().map(|joint| joint.name.as_str()).collect();
        spec.set_item("action_range", vec![[-1.0, 1.0]; names.len()])?;
        spec.set_item("actions", names)?;
        spec.set_item("rewards", Vec::<String>::new())?;
        spec.set_item("observation", self.numbers.fields().to_vec())?;
        self.object.call_method1(py, "begin", (dict, spec)).map(|_| ())
    }

    fn take(&mut self, observation: &Observation) {
        self.numbers.take(observation);
        if let Some(expert) = &self.expert {
            expert.get().show(observation);
        }
    }

    fn answer(&self, py: Python<'_>) -> PyResult<Vec<f64>> {
        let numbers = PyArray1::from_slice(py, self.numbers.latest());
        let action = self.object.call_method1(py, "act", (numbers,))?;
        let action: PyReadonlyArray1<'_, f64> = action.extract(py)?;
        Ok(action.as_slice().map_err(|_| not_contiguous("action"))?.to_vec())
    }
}

/// The terms of a session's sensors that the policy may see.
fn seen(info: &SessionInfo) -> Vec<ObservationTerm> {
    let is_seen = |name: &str| info.sensors.iter().all(|sensor| sensor.name != name || !sensor.bag_only);
    info.terms.iter().filter(|term| is_seen(&term.sensor)).cloned().collect()
}

/// Names of sensors as a policy returns them.
fn looked_at(object: &Bound<'_, PyAny>, numbers: &[f32]) -> PyResult<Vec<&'static str>> {
    let names: Vec<String> = object.call_method1("look", (PyArray1::from_slice(object.py(), numbers),))?.extract()?;
    let known = |name: &String| {
        let sensor = Known::by_name(name).map(Known::name);
        sensor.ok_or_else(|| {
            PyValueError::new_err(format!("look: '{name}' is not a sensor; known ones are {}", Known::names()))
        })
    };
    names.iter().map(known).collect()
}

impl Policy for Player {
    fn name(&self) -> String {
        self.name.clone()
    }

    fn sensors(&self) -> Vec<Sensor> {
        self.sensors.clone()
    }

    fn reset(&mut self, info: &SessionInfo, first: &Observation) -> Result<(), PolicyError> {
        self.numbers = Numbers::new(&seen(info), &info.sensors);
        let on_request = info.sensors.iter().filter(|sensor| sensor.on_request);
        self.on_request = on_request.filter_map(|sensor| Known::by_name(&sensor.name)).map(Known::name).collect();
        Python::attach(|py| self.begin(info, first, py)).map_err(|error| self.failure.note(error))
    }

    fn look(&mut self, observation: &Observation) -> Vec<&'static str> {
        // As in environments, an episode begins with a look.
        if observation.step == 0 {
            return self.on_request.clone();
        }
        if self.on_request.is_empty() {
            return Vec::new();
        }
        self.take(observation);
        let asked = Python::attach(|py| looked_at(self.object.bind(py), self.numbers.latest()));
        asked.unwrap_or_else(|error| {
            self.failure.note(error);
            self.is_lost = true;
            Vec::new()
        })
    }

    fn act(&mut self, observation: &Observation) -> Result<Command, PolicyError> {
        if self.is_lost {
            return Err(PolicyError::Failed { policy: "of Python", source: "it could not say where to look".into() });
        }
        self.take(observation);
        let numbers = Python::attach(|py| self.answer(py)).map_err(|error| self.failure.note(error))?;
        Ok(match self.form {
            ActionForm::Action => Command::Action(numbers),
            ActionForm::JointTarget => Command::JointTarget(numbers),
        })
    }
}
