//! Policy `wbc`: the whole-body controller on a fixed command, and the body that other policies stand on.

use std::sync::Arc;

use fiatlux_proto::v3::{Observation, SessionInfo};
use fiatlux_wbc::{CONTROL_DT, Controller, Network};

use super::body::{self, COMMAND, Senses};
use crate::{Command, Policy, PolicyError};

/// Legs and waist by the whole-body controller; arms and hands keep the targets that they are given.
pub(crate) struct Body {
    controller: Controller,
    senses: Senses,
    /// Of all joints, rad.
    pub targets: Vec<f64>,
}

impl Body {
    /// At the start of an episode; arms and hands keep the staged posture.
    ///
    /// # Errors
    /// The session lacks a term, or its robot is not the controller's.
    pub fn new(
        policy: &'static str,
        network: Arc<Network>,
        info: &SessionInfo,
        first: &Observation,
    ) -> Result<Self, PolicyError> {
        let targets = body::staged(policy, info, first)?;
        network.contract().fits_joints(&body::joints(info))?;
        if (info.control_dt - CONTROL_DT).abs() > 1e-9 {
            let reason = format!("its control step is {} s instead of {CONTROL_DT} s", info.control_dt);
            return Err(PolicyError::Unfit { policy, reason });
        }
        Ok(Self { controller: Controller::new(network), senses: Senses::new(policy), targets })
    }

    /// Answers an observation.
    ///
    /// # Errors
    /// An observation that lacks a term or is not finite.
    pub fn step(&mut self, observation: &Observation, command: &fiatlux_wbc::Command) -> Result<Command, PolicyError> {
        self.controller.step(&self.senses.read(observation)?, command, &mut self.targets)?;
        Ok(Command::JointTarget(self.targets.clone()))
    }
}

/// Follows one command; the arms keep the posture of the start.
pub struct Wbc {
    network: Arc<Network>,
    command: fiatlux_wbc::Command,
    body: Option<Body>,
}

impl Wbc {
    /// Reads a command such as `vx=0.4,wz=0.2,height=0.7`; what is left out is as when standing upright.
    ///
    /// # Errors
    /// [`PolicyError::Words`]: a field that is not known, or a number that cannot be read; [`PolicyError::Wbc`]: out of range.
    pub fn new(command: &str) -> Result<Self, PolicyError> {
        let network = Arc::new(Network::shipped()?);
        let command = parse(command)?;
        Controller::new(Arc::clone(&network)).check(&command)?;
        Ok(Self { network, command, body: None })
    }
}

fn parse(text: &str) -> Result<fiatlux_wbc::Command, PolicyError> {
    let mut command = fiatlux_wbc::Command::default();
    for word in body::words(text, COMMAND) {
        let (word, name, value) = word?;
        let wrong = || PolicyError::Words { word: word.into(), fields: COMMAND };
        body::set(&mut command, name, value).ok_or_else(wrong)?;
    }
    Ok(command)
}

impl Policy for Wbc {
    fn name(&self) -> String {
        "wbc".into()
    }

    fn reset(&mut self, info: &SessionInfo, first: &Observation) -> Result<(), PolicyError> {
        self.body = Some(Body::new("wbc", Arc::clone(&self.network), info, first)?);
        Ok(())
    }

    fn act(&mut self, observation: &Observation) -> Result<Command, PolicyError> {
        self.body.as_mut().ok_or_else(|| PolicyError::not_reset("wbc"))?.step(observation, &self.command)
    }
}
