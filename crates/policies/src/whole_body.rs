//! A body that policies build on: a whole-body controller, ours or a foreign one, moves legs and waist.

use std::sync::Arc;

use fiatlux_foreign::{Gear, HEIGHT};
use fiatlux_proto::v3::{Chunk, Observation, SessionInfo};
use fiatlux_wbc::{ARMS, Arms, BODY, BodyCommand, CONTROL_DT, Controller, MOVED, Network};

use super::body::{self, Senses};
use fiatlux_client::{Command, PolicyError};

/// Command of GEAR for the fields that the user leaves out.
pub(super) const UPRIGHT: BodyCommand = BodyCommand { velocity: [0.0; 3], height: HEIGHT, torso: [0.0; 3] };

/// Legs and waist follow a whole-body controller; arms and hands keep their targets.
///
/// ```no_run
/// use std::sync::Arc;
///
/// use fiatlux_client::{Command, PolicyError};
/// use fiatlux_policies::WholeBody;
/// use fiatlux_proto::v3::{Observation, SessionInfo};
/// use fiatlux_wbc::Network;
///
/// fn start(info: &SessionInfo, first: &Observation) -> Result<WholeBody, PolicyError> {
///     let network = Network::shipped().map_err(PolicyError::of("mine"))?;
///     WholeBody::own("mine", Arc::new(network), info, first)?.holding_arms(info)
/// }
///
/// fn act(body: &mut WholeBody, observation: &Observation) -> Result<Command, PolicyError> {
///     body.targets[16] = 0.5; // left shoulder roll, rad
///     body.step(observation, &fiatlux_wbc::BodyCommand { velocity: [0.3, 0.0, 0.0], ..Default::default() })
/// }
/// ```
pub struct WholeBody {
    controller: Moves,
    senses: Senses,
    arms: Option<Arms>,
    /// Targets of all joints, rad, in the session's joint order. The policy sets those of arms and hands; a step writes those
    /// of legs and waist.
    pub targets: Vec<f64>,
    /// Number of commands so far.
    count: u64,
    /// The command of the last step, and whether it is still to be recorded.
    commanded: Option<BodyCommand>,
    is_recorded: bool,
}

enum Moves {
    Own(Box<Controller>),
    Gear(Box<Gear>),
}

impl WholeBody {
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
        network.contract().fits_joints(&body::joints(info)).map_err(PolicyError::of("wbc"))?;
        if (info.control_dt - CONTROL_DT).abs() > 1e-9 {
            let reason = format!("its control step is {} s instead of {CONTROL_DT} s", info.control_dt);
            return Err(PolicyError::Unfit { policy, reason });
        }
        Ok(Self::on(policy, Moves::Own(Box::new(Controller::new(network))), targets))
    }

    /// Starts an episode with GEAR's controller.
    ///
    /// # Errors
    /// As for [`WholeBody::own`].
    pub(super) fn gear(
        policy: &'static str,
        controller: Gear,
        info: &SessionInfo,
        first: &Observation,
    ) -> Result<Self, PolicyError> {
        let targets = body::staged(policy, info, first)?;
        Ok(Self::on(policy, Moves::Gear(Box::new(controller)), targets))
    }

    fn on(policy: &'static str, controller: Moves, targets: Vec<f64>) -> Self {
        Self {
            controller,
            senses: Senses::new(policy),
            arms: None,
            targets,
            count: 0,
            commanded: None,
            is_recorded: true,
        }
    }

    /// Makes the targets of the arms the angles at which they rest: each step adds what their weight takes from them. The
    /// drives of the arms are soft, and sag otherwise.
    ///
    /// # Errors
    /// The session's robot does not have the joints of a G1.
    pub fn holding_arms(self, info: &SessionInfo) -> Result<Self, PolicyError> {
        Ok(Self { arms: Some(Arms::new(&body::joints(info)).map_err(PolicyError::of("wbc"))?), ..self })
    }

    /// Where it stands still, commands may bend it lower than the controller can walk; see [`Controller::bending_low`].
    #[must_use]
    pub fn bending_low(self) -> Self {
        let controller = match self.controller {
            Moves::Own(controller) => Moves::Own(Box::new(controller.bending_low())),
            gear @ Moves::Gear(_) => gear,
        };
        Self { controller, ..self }
    }

    /// Begins with a robot that already stands as a command has it; see [`Controller::stand_by`]. GEAR's controller does not
    /// change.
    pub fn stand_by(&mut self, command: BodyCommand) {
        if let Moves::Own(controller) = &mut self.controller {
            controller.stand_by(command);
        }
    }

    /// Never steps; see [`Controller::without_steps`]. GEAR's controller does not change.
    #[must_use]
    pub fn without_steps(self) -> Self {
        let controller = match self.controller {
            Moves::Own(controller) => Moves::Own(Box::new(controller.without_steps())),
            other => other,
        };
        Self { controller, ..self }
    }

    /// The command for standing upright.
    pub fn upright(&self) -> BodyCommand {
        match self.controller {
            Moves::Own(_) => BodyCommand::default(),
            Moves::Gear(_) => UPRIGHT,
        }
    }

    /// Where the left foot is due in its stride, as of [`fiatlux_wbc::Clock::stride`]; 0 with GEAR's controller.
    pub(super) fn stride(&self) -> f64 {
        match &self.controller {
            Moves::Own(controller) => controller.stride(),
            Moves::Gear(_) => 0.0,
        }
    }

    /// True if the robot is kept over its feet where they are; see [`Controller::is_standing`].
    pub(super) fn is_standing(&self) -> bool {
        matches!(&self.controller, Moves::Own(controller) if controller.is_standing())
    }

    /// Answers an observation with the next command.
    ///
    /// # Errors
    /// The observation lacks a term or is not finite, a network fails, or [`WholeBody::targets`] became too short.
    pub fn step(&mut self, observation: &Observation, command: &BodyCommand) -> Result<Command, PolicyError> {
        if self.targets.len() < BODY {
            let reason = format!("it has {} targets; legs, waist and arms need {BODY}", self.targets.len());
            return Err(PolicyError::Unfit { policy: self.senses.policy, reason });
        }
        let sensed = self.senses.read(observation)?;
        match &mut self.controller {
            Moves::Own(controller) => {
                controller.step(&sensed, command, &mut self.targets).map_err(PolicyError::of("wbc"))?;
            }
            Moves::Gear(controller) => {
                controller.step(&sensed, command, &mut self.targets).map_err(PolicyError::of("gear"))?;
            }
        }
        (self.count, self.commanded, self.is_recorded) = (self.count + 1, Some(*command), false);
        let mut targets = self.targets.clone();
        if let Some(arms) = &mut self.arms {
            let mut angles = [0.0; ARMS];
            angles.copy_from_slice(&targets[MOVED..BODY]);
            targets[MOVED..BODY].copy_from_slice(&arms.targets(&sensed, &angles).map_err(PolicyError::of("wbc"))?);
        }
        Ok(Command::JointTarget(targets))
    }

    /// The command of the last step.
    pub fn commanded(&self) -> Option<BodyCommand> {
        self.commanded
    }

    /// The command of the last step for the record, as a chunk of one row. Each is given once: a control step without one has none in
    /// force.
    pub fn record(&mut self) -> Option<Chunk> {
        if std::mem::replace(&mut self.is_recorded, true) {
            return None;
        }
        let numbers = self.commanded?.numbers().map(|number| number as f32);
        Some(Chunk {
            index: self.count - 1,
            values: numbers.into(),
            width: numbers.len() as u32,
            keys: BodyCommand::CHUNK_KEYS.map(String::from).into(),
            ..Chunk::default()
        })
    }
}
