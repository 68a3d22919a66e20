//! The settings of an episode as Python passes them: one dictionary for single environments, batches and sessions.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};

use fiatlux_batch::{ActionForm, RulebookOptions};
use fiatlux_client::SessionArgs;
use fiatlux_features::{Arithmetic, ResNet18, Weights};
use fiatlux_proto::v3::OpenRequest;
use fiatlux_robot::{GainSet, Gains, Robot};
use fiatlux_rules::{CONTROL_DT, Cause, Causes, Protocol, Task, Thresholds, Variant};
use fiatlux_sensing::{Sampler, Sensor, Sensors};
use fiatlux_world::{EpisodeRanges, EpisodeSpec};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::fault::refused;

/// Seed of the network's weights if no file is named, the same as a server's.
const WEIGHTS_SEED: u64 = 0;

/// Longest delay of an action, ms, as of a server.
const MAX_ACTION_DELAY_MS: u32 = 100;

/// The keys of `fiatlux.settings.Settings`, all of them present.
#[derive(Clone, FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct Settings {
    robot: String,
    gains: String,
    protocol: String,
    reward: String,
    sensors: Option<Vec<String>>,
    noise: bool,
    action_form: String,
    image_size: [usize; 2],
    weights: Option<PathBuf>,
    fix: Vec<String>,
    prop_scale: Vec<String>,
    ranges: Vec<String>,
    thresholds: BTreeMap<String, f64>,
    end_on: Vec<String>,
    action_delay: u32,
    /// Of batches alone.
    #[pyo3(default)]
    horizon_steps: Option<u64>,
    #[pyo3(default)]
    reward_weights: BTreeMap<String, f64>,
}

impl Settings {
    pub(crate) fn robot(&self) -> PyResult<(Arc<Robot>, Gains)> {
        robot(&self.robot, &self.gains)
    }

    pub(crate) fn action_form(&self) -> PyResult<ActionForm> {
        match self.action_form.as_str() {
            "action" => Ok(ActionForm::Action),
            "joint_target" => Ok(ActionForm::JointTarget),
            name => Err(PyValueError::new_err(format!("action_form is '{name}'; known ones are action, joint_target"))),
        }
    }

    /// An episode with everything that is set.
    pub(crate) fn episode(&self, task: Task, seed: u64, episode: u64) -> PyResult<EpisodeSpec> {
        let request = self.request(&[])?;
        let mut thresholds = Thresholds::default();
        for (name, value) in &request.thresholds {
            thresholds.set(&format!("{name}={value}")).map_err(|error| refused(&error))?;
        }
        let end_on: Result<Causes, _> = request.end_on.iter().map(|name| name.parse::<Cause>()).collect();
        let end_on = end_on.map_err(|error| PyValueError::new_err(format!("end_on: {error}")))?;
        let scale = fiatlux_wire::prop_scale(&request.prop_scale.unwrap_or_default());
        scale.check().map_err(|error| PyValueError::new_err(format!("prop_scale: {error}")))?;
        let ranges = fiatlux_wire::episode_ranges(&request).map_err(|error| refuse_range(&error.to_string()))?;
        if ranges.get("noise").is_some() && !self.noise {
            return Err(refuse_range("noise has a range, but noise=False; choose one of the two"));
        }
        if ranges.get("action_delay").is_some() && self.action_delay > 0 {
            return Err(refuse_range("action_delay has a range, and action_delay is set; choose one of the two"));
        }
        Ok(EpisodeSpec {
            ranges,
            protocol: self.protocol.parse::<Protocol>().map_err(|error| refused(&error))?,
            variant: self.variant()?,
            randomize: fiatlux_wire::randomization(&request.randomization.unwrap_or_default()),
            scale,
            thresholds,
            end_on: (!request.end_on.is_empty()).then_some(end_on),
            ..EpisodeSpec::new(task, seed, episode)
        })
    }

    pub(crate) fn rulebook(&self, task: Task) -> PyResult<RulebookOptions> {
        let EpisodeSpec { protocol, variant, randomize, thresholds, end_on, .. } = self.episode(task, 0, 0)?;
        Ok(RulebookOptions {
            protocol,
            variant,
            thresholds,
            end_on,
            sensors: self.sensors(task)?,
            noise: randomize.sensors,
            noise_scale: [1.0; 2],
            camera: EpisodeRanges::default(),
            action_delay: [delay_steps(self.action_delay)?; 2],
            image_size: self.image_size,
            action_form: self.action_form()?,
            horizon_steps: self.horizon_steps.unwrap_or(task.horizon_steps()),
            reward_weights: self.reward_weights.clone(),
        })
    }

    fn variant(&self) -> PyResult<Variant> {
        match self.reward.as_str() {
            "benchmark" => Ok(Variant::Benchmark),
            "training" => Ok(Variant::Training),
            name => Err(PyValueError::new_err(format!("reward is '{name}'; known ones are benchmark, training"))),
        }
    }

    /// Sensors by name with their rates; without names, those of the robot's own body.
    fn sensors(&self, task: Task) -> PyResult<Sampler> {
        let Some(names) = self.sensors.as_deref() else { return Ok(Sampler::new(Sensors::of_body(task))) };
        if names.is_empty() {
            return Ok(Sampler::new(Sensors::NONE));
        }
        for name in names {
            let plain = name.split(['@', '+']).next().unwrap_or_default().trim();
            if Sensor::by_name(plain).is_none() {
                let known = Sensor::names();
                return Err(PyValueError::new_err(format!("'{plain}' is not a sensor; known ones are {known}")));
            }
        }
        let asked = fiatlux_wire::requested_sensors(&self.request(&[])?.sensors);
        let asked = asked.map_err(|refusal| PyValueError::new_err(format!("sensors: {}", refusal.message)))?;
        Ok(Sampler::of_request(&asked, task))
    }

    /// The network of the camera's features, if the sensors need it. The last one is kept for the next episode, since it
    /// takes 95 MB and some tenths of a second to load.
    pub(crate) fn network(&self, sensors: Sensors) -> PyResult<Option<ResNet18>> {
        static KEPT: Mutex<Option<(Option<PathBuf>, ResNet18)>> = Mutex::new(None);
        if !sensors.meets(Sensors::WITH_FEATURES) {
            return Ok(None);
        }
        let mut kept = KEPT.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, network)) = kept.as_ref().filter(|(path, _)| *path == self.weights) {
            return Ok(Some(network.twin()));
        }
        let given = self.weights.as_ref().map(|path| path.display().to_string()).unwrap_or_default();
        let (own, arithmetic) = Arithmetic::of_name(&given);
        let weights = match Some(own).filter(|path| !path.is_empty()) {
            Some(path) => {
                let read = Weights::from_safetensors(path);
                read.map_err(|error| PyValueError::new_err(format!("weights: {}", fiatlux_cli::in_full(&error))))?
            }
            None => Weights::seeded(WEIGHTS_SEED),
        };
        let network = ResNet18::with(&weights, arithmetic);
        let twin = network.twin();
        *kept = Some((self.weights.clone(), network));
        Ok(Some(twin))
    }

    /// The request for a session, except task, seed and policy. `record` names the sensors to record in the bag.
    pub(crate) fn request(&self, record: &[String]) -> PyResult<OpenRequest> {
        let (robot, _) = self.robot()?;
        let mut request = OpenRequest {
            robot: robot.name().into(),
            gains: self.gains.clone(),
            reward: self.reward.clone(),
            episode_protocol: self.protocol.clone(),
            image_width: self.image_size[0] as u32,
            image_height: self.image_size[1] as u32,
            weights: self.weights.as_ref().map(|path| path.display().to_string()).unwrap_or_default(),
            ..OpenRequest::default()
        };
        request.randomization.get_or_insert_default().exact_sensors = !self.noise;
        request.action_delay_ms = self.action_delay;
        request.thresholds.extend(self.thresholds.clone());
        let lists = [
            ("--sensors", self.sensors.as_deref().unwrap_or_default()),
            ("--record", record),
            ("--fix", &self.fix),
            ("--prop-scale", &self.prop_scale),
            ("--range", &self.ranges),
            ("--end-on", &self.end_on),
        ];
        session_args(&lists)?.apply(&mut request);
        Ok(request)
    }

    /// The same for a server in this process, which reads the weights from their folder.
    pub(crate) fn split_weights(mut self) -> (Self, Option<PathBuf>) {
        let Some(path) = &self.weights else { return (self, None) };
        let folder = path.parent().map(PathBuf::from).unwrap_or_default();
        self.weights = path.file_name().map(PathBuf::from);
        (self, Some(folder))
    }
}

fn refuse_range(problem: &str) -> PyErr {
    PyValueError::new_err(format!("ranges: {problem}"))
}

/// A delay in ms as control steps.
pub(crate) fn delay_steps(ms: u32) -> PyResult<usize> {
    let step_ms = (CONTROL_DT * 1e3).round() as u32;
    if ms > MAX_ACTION_DELAY_MS || !ms.is_multiple_of(step_ms) {
        let rule = format!("give a multiple of {step_ms} ms, at most {MAX_ACTION_DELAY_MS}");
        return Err(PyValueError::new_err(format!("action_delay is {ms}; {rule}")));
    }
    Ok((ms / step_ms) as usize)
}

/// Flags of the programs, and the arguments of the same meaning.
const FLAGS: [(&str, &str); 6] = [
    ("--sensors", "sensors"),
    ("--record", "record"),
    ("--fix", "fix"),
    ("--prop-scale", "prop_scale"),
    ("--range", "ranges"),
    ("--end-on", "end_on"),
];

/// Parses lists as the programs' flags do.
fn session_args(lists: &[(&str, &[String])]) -> PyResult<SessionArgs> {
    #[derive(clap::Parser)]
    struct Flags {
        #[command(flatten)]
        session: SessionArgs,
    }
    let given = lists.iter().filter(|(_, names)| !names.is_empty());
    let flags = given.map(|(flag, names)| format!("{flag}={}", names.join(",")));
    let parsed = <Flags as clap::Parser>::try_parse_from(std::iter::once("fiatlux".into()).chain(flags));
    parsed.map(|flags| flags.session).map_err(|error| {
        let text = error.to_string();
        let mut problem = text.lines().next().unwrap_or_default().trim_start_matches("error: ").to_owned();
        // In Python the settings are arguments, not flags.
        for (flag, argument) in FLAGS {
            if let Some(at) = problem.find(&format!("for '{flag} <")) {
                let rest = problem[at..].split_once(">'").map_or("", |(_, rest)| rest).to_owned();
                let value = problem.split('\'').nth(1).unwrap_or_default().to_owned();
                problem = format!("{argument}: '{value}' is refused{rest}");
                break;
            }
        }
        // What is possible stands in the next lines.
        let possible = text.lines().map(str::trim).find(|line| line.starts_with("[possible values:"));
        let possible = possible.map(|line| line.trim_start_matches("[possible values: ").trim_end_matches(']'));
        PyValueError::new_err(match possible {
            Some(names) => format!("{problem}; known ones are {names}"),
            None => problem,
        })
    })
}

pub(crate) fn robot(name: &str, gains: &str) -> PyResult<(Arc<Robot>, Gains)> {
    let robot = Robot::known(name).and_then(Robot::by_name).map_err(|error| refused(&error))?;
    let set: GainSet = gains.parse().map_err(|error| PyValueError::new_err(format!("gains: {error}")))?;
    let gains = robot.gains(set);
    Ok((Arc::new(robot), gains))
}
