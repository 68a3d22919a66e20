//! The policy `replay`: stands here, not with the others, for what verifies links no skills.

use std::path::Path;

use fiatlux_bag::Bag;
use fiatlux_proto::v3::{EpisodeHeader, EpisodeResult, Observation, OpenRequest, SessionInfo};

use crate::{Command, Policy, PolicyError};

/// Most actions that are read. An errand has 72,000.
const MAX_ACTIONS: usize = 1 << 20;

/// Sends the actions of a recorded episode again, exactly as they were received.
#[derive(Debug)]
pub struct Replay {
    header: EpisodeHeader,
    result: Option<EpisodeResult>,
    commands: Vec<Command>,
}

impl Replay {
    /// Reads the actions of a bag.
    ///
    /// # Errors
    /// The bag cannot be read.
    pub fn open(path: &Path) -> Result<Self, PolicyError> {
        let bag = Bag::open(path).map_err(PolicyError::of("replay"))?;
        let mut commands = Vec::new();
        for message in bag.actions().take(MAX_ACTIONS) {
            let action = message.map_err(PolicyError::of("replay"))?.action.unwrap_or_default();
            let targets = action.action.is_empty() && !action.joint_target.is_empty();
            let command =
                if targets { Command::JointTarget(action.joint_target) } else { Command::Action(action.action) };
            commands.push(command);
        }
        Ok(Self { header: bag.header().clone(), result: bag.result().cloned(), commands })
    }

    /// The header of the recorded episode.
    pub fn header(&self) -> &EpisodeHeader {
        &self.header
    }

    /// The request for a session with the same rows.
    pub fn request(&self) -> OpenRequest {
        self.header.request_again()
    }

    /// The result of the recorded episode; `None` if the bag was cut before its end.
    pub fn result(&self) -> Option<&EpisodeResult> {
        self.result.as_ref()
    }
}

impl Policy for Replay {
    fn name(&self) -> String {
        format!("replay:{}", self.header.policy)
    }

    fn reset(&mut self, info: &SessionInfo, _first: &Observation) -> Result<(), PolicyError> {
        let names = info.joints.iter().map(|joint| &joint.name);
        if names.eq(&self.header.joint_names) {
            return Ok(());
        }
        let reason = "the bag's robot has other joints; replay it on a server of the version that recorded it".into();
        Err(PolicyError::Unfit { policy: "replay", reason })
    }

    fn act(&mut self, observation: &Observation) -> Result<Command, PolicyError> {
        let command = self.foresee(observation.step);
        command.ok_or(PolicyError::Ended { actions: self.commands.len(), step: observation.step })
    }

    fn foresee(&self, step: u64) -> Option<Command> {
        usize::try_from(step).ok().and_then(|step| self.commands.get(step)).cloned()
    }
}
