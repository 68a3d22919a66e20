//! The simulation of a session: its episodes, and what its client senses and its bag stores of them, as messages.

#[cfg(test)]
pub(super) mod tests;

use std::sync::Arc;

use fiatlux_access::{Identity, sign_result};
use fiatlux_cli::in_full;
use fiatlux_features::ResNet18;
use fiatlux_play::{Play, PlayError, Received};
use fiatlux_proto::encode;
use fiatlux_proto::v3::refusal::Code;
use fiatlux_proto::v3::{ActionRecord, EpisodeResult, Observation, Refusal, SessionInfo, StepRecord};
use fiatlux_sensing::{SenseError, Sensor, SensorSuite, Sensors};
use fiatlux_session::{Command, Host};
use fiatlux_world::Episode;

use super::info;
use super::plan::{Plan, SensorPlan};
use super::record::{self, Record, SensorData};
use super::runs::Attempt;
use super::scenes::Built;

/// Episodes of one plan, in one scene.
#[derive(Debug)]
pub(super) struct Simulation {
    server: String,
    id: String,
    plan: Plan,
    built: Built,
    /// The sensors as an episode begins with them.
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
    play: Play,
    /// `None` before row 0 is recorded.
    record: Option<Record>,
    observation: Observation,
    /// Of the last command, until it is recorded.
    received: Received,
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
            whole_body_range: if senses { fiatlux_play::whole_body_range(scene) } else { Vec::new() },
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
        let (suite, built) = (self.suite.clone(), &self.built);
        let mut play = Play::start_with(episode, suite, self.plan.action_delay, || built.visuals())
            .map_err(|error| sensors_fail(&error))?;
        let observation = observe(&mut play, self.plan.sensors.due(0)).map_err(|error| sensors_fail(&error))?;
        let run = Run { play, record: None, observation, received: Received::default() };
        Ok(&self.run.insert(run).observation)
    }

    fn step(&mut self, command: &Command) -> Result<&Observation, Refusal> {
        let run = self.run.as_mut().ok_or_else(no_episode)?;
        run.received = run.play.step(command).map_err(|error| not_carried_out(&error))?;
        let episode = run.play.episode();
        note_row(self.attempt.as_deref(), episode)?;
        let due = self.plan.sensors.due(episode.row().step);
        run.observation = observe(&mut run.play, due).map_err(|error| sensors_fail(&error))?;
        Ok(&run.observation)
    }

    fn look(&mut self, names: &[String]) -> Result<Observation, Refusal> {
        let run = self.run.as_mut().ok_or_else(no_episode)?;
        let asked = sensors(names, &self.plan.sensors)?;
        run.play.observe(asked).map_err(|error| Refusal::new(Code::Value, "sensors", in_full(&error)))
    }

    fn record(&mut self, action: Option<ActionRecord>, large: bool) -> Result<StepRecord, Refusal> {
        let Self { plan, run, .. } = self;
        let run = run.as_mut().ok_or_else(no_episode)?;
        let seen = recorded(&mut run.play, &plan.sensors, large, &run.observation);
        let seen = seen.map_err(|error| sensors_fail(&error))?;
        let episode = run.play.episode();
        if let Some((record, action)) = run.record.as_mut().zip(action) {
            let mut action = ActionRecord { outside_box: run.received.outside_box, ..action };
            if let (Some(target), Some(received)) = (run.received.followed.take(), &mut action.action) {
                received.joint_target = target;
            }
            return Ok(record.row(episode, &action, seen));
        }
        let labels = info::Labels { weights: &self.weights, meshes: self.built.meshes() };
        let header = info::header(&self.server, &self.id, plan, labels, episode);
        let (record, first) = Record::start(episode, header, self.built.shapes.to_vec(), seen);
        run.record = Some(record);
        Ok(first)
    }

    fn cut_short(&self, cause: &str, why: &str) -> EpisodeResult {
        if let Some(attempt) = &self.attempt {
            attempt.is_cut_short(why);
        }
        let cut = |run: &Run| record::cut_short(run.play.episode(), cause, run.record.as_ref());
        self.run.as_ref().map(cut).unwrap_or_default()
    }

    fn sign(&self, result: &mut EpisodeResult) {
        if let Some(signer) = &self.signer {
            sign_result(signer, result);
        }
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

fn not_carried_out(error: &PlayError) -> Refusal {
    match error {
        PlayError::Episode(error) => Refusal::new(Code::Value, "action", in_full(error)),
        error => Refusal::new(Code::Value, "whole_body", in_full(error)),
    }
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
fn observe(play: &mut Play, due: Sensors) -> Result<Observation, SenseError> {
    Ok(Observation { end: record::end(play.episode()), ..play.observe(due)? })
}

/// Sensor values that the bag stores of the last row, whose observation has been published.
fn recorded(
    play: &mut Play,
    sensors: &SensorPlan,
    large: bool,
    published: &Observation,
) -> Result<SensorData, SenseError> {
    /// Sensors that have topics of their own.
    const APART: Sensors = Sensors::of(&[Sensor::Camera, Sensor::Lidar]);
    let step = play.episode().row().step;
    let wanted = sensors.recorded(step);
    let wanted = if large { wanted } else { wanted.without(Sensors::LARGE) };
    let observation = match wanted.without(APART) {
        same if same == sensors.due(step) => encode(published),
        others => encode(&observe(play, others)?),
    };
    let mut seen = SensorData { observation, ..SensorData::default() };
    let (suite, view) = play.senses();
    if wanted.contains(Sensor::Camera) {
        seen.camera = encode(&suite.compressed_image(Sensor::Camera, &view)?);
    }
    if wanted.contains(Sensor::Lidar) {
        seen.lidar = encode(&suite.point_cloud(&view)?);
    }
    Ok(seen)
}
