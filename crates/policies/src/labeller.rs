//! Plays a recorded episode again, and asks the expert in each step what it would do.

use std::path::Path;

use fiatlux_client::{Command, Policy, PolicyError, Replay};
use fiatlux_proto::v3::{EpisodeHeader, EpisodeResult, Observation, OpenRequest, Sensor, SessionInfo};

use crate::expert::{Expert, Label};

/// A policy that acts as a bag says, while the expert follows.
pub struct Labeller {
    replay: Replay,
    expert: Expert,
    labels: Vec<Result<Label, PolicyError>>,
}

impl Labeller {
    /// Reads a bag's actions.
    ///
    /// # Errors
    /// The bag cannot be read, or the expert cannot be made.
    pub fn open(bag: &Path) -> Result<Self, PolicyError> {
        Ok(Self { replay: Replay::open(bag)?, expert: Expert::new()?, labels: Vec::new() })
    }

    /// The header of the recorded episode.
    pub fn header(&self) -> &EpisodeHeader {
        self.replay.header()
    }

    /// The result of the recorded episode; `None` if the bag was cut before its end.
    pub fn result(&self) -> Option<&EpisodeResult> {
        self.replay.result()
    }

    /// The request for a session with the same rows, in which the expert sees what it needs. Sensors change no row.
    pub fn request(&self) -> OpenRequest {
        OpenRequest { sensors: self.sensors(), weights: String::new(), ..self.replay.request() }
    }

    /// The expert's answer in each step, or why it could not go on; it begins anew only with an episode.
    pub fn labels(&self) -> &[Result<Label, PolicyError>] {
        &self.labels
    }
}

impl Policy for Labeller {
    fn name(&self) -> String {
        self.replay.name()
    }

    fn sensors(&self) -> Vec<Sensor> {
        self.expert.sensors()
    }

    fn reset(&mut self, info: &SessionInfo, first: &Observation) -> Result<(), PolicyError> {
        self.labels.clear();
        self.replay.reset(info, first)?;
        self.expert.reset(info, first)
    }

    fn act(&mut self, observation: &Observation) -> Result<Command, PolicyError> {
        let command = self.replay.act(observation)?;
        let label = match self.labels.last() {
            Some(Err(ended)) => Err(PolicyError::Unfit { policy: "expert", reason: ended.to_string() }),
            _ => self.expert.label(observation),
        };
        self.labels.push(label);
        Ok(command)
    }
}
