//! The simulation of a session: its episodes, and what its client senses and its bag stores of them, as messages.

#[cfg(test)]
pub(super) mod tests;

use std::borrow::Cow;
use std::collections::VecDeque;
use std::sync::Arc;

use fiatlux_access::{Identity, sign_result};
use fiatlux_cli::in_full;
use fiatlux_features::ResNet18;
use fiatlux_proto::v3::refusal::Code;
use fiatlux_proto::v3::{ActionRecord, EpisodeResult, Observation, Refusal, SessionInfo, StepRecord};
use fiatlux_proto::{BodyCommand, encode};
use fiatlux_render::Lighting;
use fiatlux_sensing::{NoiseSeed, SenseError, Sensor, SensorSuite, Sensors, View};
use fiatlux_session::{Command, Host};
use fiatlux_world::{Episode, delay_steps, noise_scale};

use super::info;
use super::plan::{Plan, SensorPlan};
use super::record::{self, Record, SensorData};
use super::runs::Attempt;
use super::scenes::Built;
use super::whole_body::{self, WholeBody};

/// Episodes of one plan, in one scene.
#[derive(Debug)]
pub(super) struct Simulation {
    server: String,
    id: String,
    plan: Plan,
    built: Built,
    suite: SensorSuite,
    /// Label of the weights of the camera's features; empty without them.
    weights: String,
    run: Option<Run>,
    /// The attempt at an episode of a run that it plays.
    attempt: Option<Arc<Attempt>>,
    /// Identity that signs the results.
    signer: Option<Arc<Identity>>,
}

#[derive(Debug)]
struct Run {
    episode: Episode,
    /// `None` before row 0 is recorded.
    record: Option<Record>,
    observation: Observation,
    /// A number of the last action was outside the box [-1, 1].
    outside_box: bool,
    /// Actions on their way to the robot, next one first.
    delayed: VecDeque<Vec<f64>>,
    /// The controller while the client commands it, and the joint targets that came of the last command, rad.
    whole_body: Option<WholeBody>,
    followed: Option<Vec<f64>>,
}

impl Simulation {
    pub fn new(server: &str, id: &str, plan: Plan, built: Built, network: Option<ResNet18>) -> Self {
        let weights = network.as_ref().map(|network| network.label().to_owned()).unwrap_or_default();
        let suite = SensorSuite::new(plan.sensors.all(), plan.setup(&built.scene));
        let suite = suite.with_sight(plan.sensors.sight()).with_network(network);
        Self {
            server: server.into(),
            id: id.into(),
            plan,
            built,
            suite,
            weights,
            run: None,
            attempt: None,
            signer: None,
        }
    }

    /// Makes it play one episode of a run, which must repeat the rows of earlier attempts.
    pub fn of_run(self, attempt: Option<Arc<Attempt>>) -> Self {
        Self { attempt, ..self }
    }

    /// Makes it sign its results.
    pub fn signed_by(self, signer: Option<Arc<Identity>>) -> Self {
        Self { signer, ..self }
    }

    /// The session's description for its client, without its timeouts.
    pub fn info(&self) -> SessionInfo {
        let scene = &self.built.scene;
        let senses = self.plan.sensors.sensed().contains(Sensor::Proprioception);
        SessionInfo {
            whole_body_range: if senses { whole_body::ranges(scene) } else { Vec::new() },
            ..info::session(&self.server, &self.id, &self.plan, self.labels(), scene)
        }
    }

    fn labels(&self) -> info::Labels<'_> {
        info::Labels { weights: &self.weights, meshes: self.built.meshes() }
    }
}

impl Host for Simulation {
    fn stage(&mut self, episode: u64) -> Result<&Observation, Refusal> {
        #[cfg(test)]
        assert_ne!(self.plan.request.policy, tests::PANICS, "a test asked for it");
        self.run = None;
        self.attempt.as_ref().map_or(Ok(()), |attempt| attempt.stage(episode))?;
        let spec = self.plan.episode(episode);
        let start = |error: &dyn std::error::Error| self.plan.does_not_start("", error);
        let scene = self.built.for_episode(&spec).map_err(|error| start(&error))?;
        let episode = Episode::start(scene, &spec).map_err(|error| start(&error))?;
        note_row(self.attempt.as_deref(), &episode)?;
        let (suite, built, varied) = (&mut self.suite, &self.built, spec.varied());
        suite.scale_noise(noise_scale(&varied));
        let observation = suite
            .begin(episode.scene(), NoiseSeed::of(&spec), || built.visuals(), Lighting::of(&spec.light()))
            .and_then(|()| observe(suite, &episode, self.plan.sensors.due(0)))
            .map_err(|error| sensors_fail(&error))?;
        // Until the first action arrives, the staged posture holds.
        let delay = delay_steps(&varied).unwrap_or(self.plan.action_delay);
        let delayed = VecDeque::from(vec![episode.row().action.clone(); delay]);
        let (whole_body, followed) = (None, None);
        let run = Run { episode, record: None, observation, outside_box: false, delayed, whole_body, followed };
        Ok(&self.run.insert(run).observation)
    }

    fn step(&mut self, command: &Command) -> Result<&Observation, Refusal> {
        let run = self.run.as_mut().ok_or_else(no_episode)?;
        let action = match command {
            Command::Action(action) => Cow::Borrowed(action),
            Command::JointTarget(target) => Cow::Owned(run.episode.action_for(target)),
            Command::WholeBody(command, named) => {
                let target = run.follow(&mut self.suite, command, named)?;
                let action = run.episode.action_for(&target);
                run.followed = Some(target);
                Cow::Owned(action)
            }
        };
        if !matches!(command, Command::WholeBody(..)) {
            run.whole_body = None;
        }
        // Flags of the action that arrived and is recorded; the row has the one that takes effect.
        run.outside_box = action.iter().any(|number| number.abs() > 1.0);
        let acting = if run.delayed.is_empty() {
            action
        } else {
            run.delayed.push_back(action.into_owned());
            Cow::Owned(run.delayed.pop_front().unwrap_or_default())
        };
        run.episode.step(&acting).map_err(|error| Refusal::new(Code::Value, "action", in_full(&error)))?;
        note_row(self.attempt.as_deref(), &run.episode)?;
        let due = self.plan.sensors.due(run.episode.row().step);
        run.observation = observe(&mut self.suite, &run.episode, due).map_err(|error| sensors_fail(&error))?;
        Ok(&run.observation)
    }

    fn look(&mut self, names: &[String]) -> Result<Observation, Refusal> {
        let run = self.run.as_ref().ok_or_else(no_episode)?;
        let asked = sensors(names, &self.plan.sensors)?;
        let seen = self.suite.observe(&View::of(&run.episode), asked);
        seen.map_err(|error| Refusal::new(Code::Value, "sensors", in_full(&error)))
    }

    fn record(&mut self, action: Option<ActionRecord>, large: bool) -> Result<StepRecord, Refusal> {
        let Self { plan, suite, run, .. } = self;
        let run = run.as_mut().ok_or_else(no_episode)?;
        let seen = recorded(suite, &run.episode, &plan.sensors, large, &run.observation);
        let seen = seen.map_err(|error| sensors_fail(&error))?;
        if let Some((record, action)) = run.record.as_mut().zip(action) {
            let mut action = ActionRecord { outside_box: run.outside_box, ..action };
            if let (Some(target), Some(received)) = (run.followed.take(), &mut action.action) {
                received.joint_target = target;
            }
            return Ok(record.row(&run.episode, &action, seen));
        }
        let labels = info::Labels { weights: &self.weights, meshes: self.built.meshes() };
        let header = info::header(&self.server, &self.id, plan, labels, &run.episode);
        let (record, first) = Record::start(&run.episode, header, self.built.shapes.to_vec(), seen);
        run.record = Some(record);
        Ok(first)
    }

    fn cut_short(&self, cause: &str, why: &str) -> EpisodeResult {
        if let Some(attempt) = &self.attempt {
            attempt.is_cut_short(why);
        }
        self.run.as_ref().map(|run| record::cut_short(&run.episode, cause, run.record.as_ref())).unwrap_or_default()
    }

    fn sign(&self, result: &mut EpisodeResult) {
        if let Some(signer) = &self.signer {
            sign_result(signer, result);
        }
    }
}

impl Run {
    /// Joint targets that follow a whole-body command, rad. The controller sees what a client would, with the same noise.
    fn follow(&mut self, suite: &mut SensorSuite, command: &BodyCommand, named: &[f64]) -> Result<Vec<f64>, Refusal> {
        const SENSES: Sensors = Sensors::of(&[Sensor::Proprioception]);
        let refused = |error: &dyn std::error::Error| Refusal::new(Code::Value, "whole_body", in_full(error));
        let seen = suite.observe(&View::of(&self.episode), SENSES).map_err(|error| refused(&error))?;
        let seen = seen.proprioception.unwrap_or_default();
        let body = match &mut self.whole_body {
            Some(body) => body,
            none => {
                let action = &self.episode.row().action;
                none.insert(WholeBody::take_over(self.episode.scene(), action).map_err(|error| refused(&error))?)
            }
        };
        body.step(&seen, command, named).map_err(|error| refused(&error))
    }
}

/// Passes a row on to an attempt at an episode of a run, which may have to repeat an earlier row.
fn note_row(attempt: Option<&Attempt>, episode: &Episode) -> Result<(), Refusal> {
    let (step, is_last) = (episode.row().step, episode.end().is_some());
    attempt.map_or(Ok(()), |attempt| attempt.row(step, episode.digest(), is_last))
}

fn no_episode() -> Refusal {
    Refusal::new(Code::Value, "", "no episode runs; send reset")
}

fn sensors_fail(error: &SenseError) -> Refusal {
    Refusal::new(Code::Start, "sensors", in_full(error))
}

fn sensors(names: &[String], plan: &SensorPlan) -> Result<Sensors, Refusal> {
    let mut asked = Sensors::NONE;
    for name in names {
        let sensor = Sensor::by_name(name).filter(|sensor| plan.sensed().contains(*sensor)).ok_or_else(|| {
            let known: Vec<_> = plan.sensed().iter().map(Sensor::name).collect();
            let message = format!("the session has no sensor '{name}' but {}; name it in open", known.join(", "));
            Refusal::new(Code::Unknown, "sensors", message)
        })?;
        asked = asked.with(sensor);
    }
    Ok(asked)
}

/// The observation of the last row.
fn observe(suite: &mut SensorSuite, episode: &Episode, due: Sensors) -> Result<Observation, SenseError> {
    Ok(Observation { end: record::end(episode), ..suite.observe(&View::of(episode), due)? })
}

/// Sensor values that the bag stores of the last row, whose observation has been published.
fn recorded(
    suite: &mut SensorSuite,
    episode: &Episode,
    sensors: &SensorPlan,
    large: bool,
    published: &Observation,
) -> Result<SensorData, SenseError> {
    /// Sensors that have topics of their own.
    const APART: Sensors = Sensors::of(&[Sensor::Camera, Sensor::Lidar]);
    let step = episode.row().step;
    let wanted = sensors.recorded(step);
    let wanted = if large { wanted } else { wanted.without(Sensors::LARGE) };
    let observation = match wanted.without(APART) {
        same if same == sensors.due(step) => encode(published),
        others => encode(&observe(suite, episode, others)?),
    };
    let mut seen = SensorData { observation, ..SensorData::default() };
    if wanted.contains(Sensor::Camera) {
        seen.camera = encode(&suite.compressed_image(Sensor::Camera, &View::of(episode))?);
    }
    if wanted.contains(Sensor::Lidar) {
        seen.lidar = encode(&suite.point_cloud(&View::of(episode))?);
    }
    Ok(seen)
}
