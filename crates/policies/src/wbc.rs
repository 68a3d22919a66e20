//! The policy `wbc`: the whole-body controller, or another that was trained here, with a fixed command.

use std::sync::Arc;

use fiatlux_proto::v3::{Chunk, Observation, SessionInfo};
use fiatlux_wbc::{BodyCommand, Controller, Network};

use super::body;
use super::whole_body::WholeBody;
use fiatlux_client::{Command, Policy, PolicyError};

use crate::entry::Entry;

/// As a program makes it.
pub(crate) const ENTRY: Entry = Entry {
    name: "wbc[:COMMAND]",
    does: "walks, turns and bends on one command, such as wbc:vx=0.4,wz=0.2 (vx -0.5 to 1.0 m/s, vy -0.4 to 0.4 m/s, wz -1.0 to \
           1.0 rad/s, height 0.65 to 0.79 m, roll, pitch, yaw of the torso in rad); the arms keep the posture of the start; \
           wbc:FILE,vx=0.4 with weights of your own",
    make: |command| Ok(Box::new(Wbc::new(command)?)),
};

/// Follows one command; the arms keep the staged posture.
pub struct Wbc {
    name: String,
    network: Arc<Network>,
    command: BodyCommand,
    body: Option<WholeBody>,
}

impl Wbc {
    /// Parses a command such as `vx=0.4,wz=0.2,height=0.7`; fields left out are those of standing upright. A first word without
    /// `=` is the file of other weights: `FILE,vx=0.4`.
    ///
    /// # Errors
    /// [`PolicyError::Words`]: an unknown field, or a value that is not a number; [`PolicyError::Failed`]: out of range, or a file
    /// that cannot be read or does not fit.
    pub fn new(text: &str) -> Result<Self, PolicyError> {
        let (first, rest) = text.split_once(',').unwrap_or((text, ""));
        let has_file = !first.is_empty() && !first.contains('=');
        let (file, words) = if has_file { (first, rest) } else { ("", text) };
        let (name, network) = body::network("wbc", file, text)?;
        let command = parse(words)?;
        Controller::new(Arc::clone(&network)).check(&command).map_err(PolicyError::of("wbc"))?;
        Ok(Self { name, network, command, body: None })
    }
}

fn parse(text: &str) -> Result<BodyCommand, PolicyError> {
    let mut command = BodyCommand::default();
    for word in body::words(text, BodyCommand::NAME_LIST) {
        let (word, name, value) = word?;
        let wrong = || PolicyError::Words { word: word.into(), fields: BodyCommand::NAME_LIST };
        body::set(&mut command, name, value).ok_or_else(wrong)?;
    }
    Ok(command)
}

impl Policy for Wbc {
    fn name(&self) -> String {
        self.name.clone()
    }

    fn reset(&mut self, info: &SessionInfo, first: &Observation) -> Result<(), PolicyError> {
        self.body = Some(WholeBody::own("wbc", Arc::clone(&self.network), info, first)?);
        Ok(())
    }

    fn act(&mut self, observation: &Observation) -> Result<Command, PolicyError> {
        self.body.as_mut().ok_or_else(|| PolicyError::not_reset("wbc"))?.step(observation, &self.command)
    }
    fn source(&mut self) -> Option<Chunk> {
        self.body.as_mut()?.record()
    }
}
