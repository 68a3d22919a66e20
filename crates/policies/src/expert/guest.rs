//! Another's policy for one subtask of the errand.

use fiatlux_client::{Command, Policy, PolicyError};
use fiatlux_proto::v3::{Chunk, Observation, ObservationTerm, Sensor, SessionInfo};
use fiatlux_rules::Task;
use nalgebra::Vector3;

use super::errand::Facts;

/// Sensors of a session for which a policy asks for none.
const OF_BODY: [&str; 4] = ["proprioception", "hand_contact", "limb_contact", "last_action"];
/// Way of the pelvis within which the robot stays while nobody moves it from its place, m.
const PLACE_M: f64 = 0.03;
/// Height of the pelvis below which the robot is on the floor and not on a tread, m: upright on the lowest one it is above 1 m.
const FLOOR_M: f64 = 0.95;
/// Longest name of a phase in a message, bytes.
const MAX_PHASE: usize = 64;

/// A policy for a subtask, and how far it is.
pub(super) struct Guest {
    pub task: Task,
    pub policy: Box<dyn Policy>,
    /// All sensors that it is shown.
    sensors: Vec<Sensor>,
    /// Terms of the session, by which its observations are cut out.
    terms: Vec<ObservationTerm>,
    /// Step at which its subtask began.
    since: u64,
    /// Its word after its last action: that nothing is left to do, or that something is.
    said: Option<bool>,
    /// Where the pelvis has been since the subtask was last not done.
    place: Option<Vector3<f64>>,
}

impl Guest {
    pub(super) fn new(task: Task, policy: Box<dyn Policy>) -> Self {
        let sensors = shown_for(policy.sensors());
        Self { task, policy, sensors, terms: Vec::new(), since: 0, said: None, place: None }
    }

    /// Sensors that a session must have for it.
    pub(super) fn sensors(&self) -> &[Sensor] {
        &self.sensors
    }

    /// Begins its subtask from what an observation of the errand shows.
    pub(super) fn begin(&mut self, info: &SessionInfo, first: &Observation) -> Result<(), PolicyError> {
        (self.since, self.said, self.place) = (first.step, None, None);
        self.terms.clone_from(&info.terms);
        let mut own = info.clone();
        own.sensors.retain(|sensor| self.is_shown(&sensor.name));
        own.terms.retain(|term| self.is_shown(&term.sensor));
        own.task = Some(fiatlux_wire::task_message(self.task));
        let first = self.shown(first);
        self.policy.reset(&own, &first)
    }

    pub(super) fn look(&mut self, observation: &Observation) -> Vec<&'static str> {
        let shown = self.shown(observation);
        self.policy.look(&shown)
    }

    pub(super) fn act(&mut self, observation: &Observation) -> Result<Command, PolicyError> {
        let shown = self.shown(observation);
        self.policy.act(&shown)
    }

    pub(super) fn source(&mut self) -> Option<Chunk> {
        let chunk = self.policy.source();
        self.said = chunk.as_ref().and_then(|chunk| chunk.is_over);
        chunk
    }

    /// Sees what is the case in the errand.
    pub(super) fn watch(&mut self, is: &Facts, observation: &Observation) {
        let pelvis = observation.privileged.as_ref().and_then(|seen| seen.robot.as_ref());
        let pelvis = pelvis.and_then(|pose| Some(Vector3::from_column_slice(pose.position.get(..3)?)));
        let pelvis = pelvis.filter(|pelvis| is.due() != Some(self.task) && (is.is_up || pelvis.z < FLOOR_M));
        self.place = match (pelvis, self.place) {
            (Some(pelvis), Some(place)) if (pelvis - place).norm() > PLACE_M => None,
            (Some(pelvis), place) => Some(place.unwrap_or(pelvis)),
            (None, _) => None,
        };
    }

    /// It says that nothing is left to do; or it says nothing, another subtask is due, and the robot stays in its place on the floor
    /// or on the platform.
    pub(super) fn is_over(&self) -> bool {
        self.said.unwrap_or(self.place.is_some())
    }

    fn is_shown(&self, sensor: &str) -> bool {
        self.sensors.iter().any(|own| own.name == sensor)
    }

    /// The observation as an episode of its subtask has it.
    fn shown(&self, observation: &Observation) -> Observation {
        since(&observation.of_sensors(&self.terms, |sensor| self.is_shown(sensor)), self.since)
    }
}

/// Sensors that a policy is shown that asks for these; if empty, those of the robot's own body.
pub(super) fn shown_for(asked: Vec<Sensor>) -> Vec<Sensor> {
    if asked.is_empty() { OF_BODY.map(Sensor::from).into() } else { asked }
}

/// An observation as it is in an episode that began at a step.
pub(super) fn since(observation: &Observation, step: u64) -> Observation {
    Observation { step: observation.step.saturating_sub(step), ..observation.clone() }
}

/// The name of a phase, not longer than a message may have it.
pub(super) fn shortened(mut phase: String) -> String {
    phase.truncate(phase.floor_char_boundary(MAX_PHASE));
    phase
}
