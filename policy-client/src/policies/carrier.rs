//! A body on which policies build: a whole-body controller, ours or a foreign one, moves legs and waist.

use std::sync::Arc;

use fiatlux_foreign::Gear;
use fiatlux_proto::v3::{Chunk, Observation, SessionInfo};
use fiatlux_wbc::{CONTROL_DT, Controller, Network};

use super::body::{self, Senses};
use super::foreign::GearFiles;
use crate::{Command, PolicyError};

/// A command's parts in the record, as KEY:NUMBERS, in the order of [`fiatlux_wbc::Command::numbers`].
const RECORDED: [&str; 3] = ["navigate:3", "height:1", "torso:3"];

/// Legs and waist follow a whole-body controller; arms and hands keep their targets.
pub(crate) struct Body {
    controller: Moves,
    senses: Senses,
    /// Targets of all joints, rad.
    pub targets: Vec<f64>,
    /// Number of the last command, from 0, and the command.
    commanded: Option<(u64, fiatlux_wbc::Command)>,
}

enum Moves {
    Own(Box<Controller>),
    Gear(Box<Gear>),
}

impl Body {
    /// Starts an episode with our controller; arms and hands keep the staged posture.
    ///
    /// # Errors
    /// The session lacks a term, or its robot is not the controller's.
    pub fn own(
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
        Ok(Self::on(policy, Moves::Own(Box::new(Controller::new(network))), targets))
    }

    /// Starts an episode with GEAR's controller.
    ///
    /// # Errors
    /// As for [`Body::own`], or gains other than the controller's.
    pub fn gear(
        policy: &'static str,
        files: &GearFiles,
        info: &SessionInfo,
        first: &Observation,
    ) -> Result<Self, PolicyError> {
        let targets = body::staged(policy, info, first)?;
        Ok(Self::on(policy, Moves::Gear(Box::new(files.controller(policy, info)?)), targets))
    }

    fn on(policy: &'static str, controller: Moves, targets: Vec<f64>) -> Self {
        Self { controller, senses: Senses::new(policy), targets, commanded: None }
    }

    /// The command for standing upright.
    pub fn upright(&self) -> fiatlux_wbc::Command {
        match self.controller {
            Moves::Own(_) => fiatlux_wbc::Command::default(),
            Moves::Gear(_) => GearFiles::UPRIGHT,
        }
    }

    /// Answers an observation with the next command.
    ///
    /// # Errors
    /// The observation lacks a term or is not finite, or a network fails.
    pub fn step(&mut self, observation: &Observation, command: &fiatlux_wbc::Command) -> Result<Command, PolicyError> {
        let sensed = self.senses.read(observation)?;
        match &mut self.controller {
            Moves::Own(controller) => controller.step(&sensed, command, &mut self.targets)?,
            Moves::Gear(controller) => controller.step(&sensed, command, &mut self.targets)?,
        }
        self.commanded = Some((self.commanded.map_or(0, |(count, _)| count + 1), *command));
        Ok(Command::JointTarget(self.targets.clone()))
    }

    /// The last command for the record, as a chunk of one row.
    pub fn record(&self) -> Option<Chunk> {
        let (index, command) = self.commanded?;
        let numbers = command.numbers().map(|number| number as f32);
        Some(Chunk {
            index,
            values: numbers.into(),
            width: numbers.len() as u32,
            keys: RECORDED.map(String::from).into(),
            ..Chunk::default()
        })
    }
}
