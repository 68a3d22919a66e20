//! The controller in use.

use std::sync::Arc;

use crate::network::Scratch;
use crate::standing::Standing;
use crate::{
    ACTION_CLAMP, BODY, BodyCommand, Clock, History, MOVED, NOMINAL_HEIGHT, Network, Sensed, Setpoint, WbcError,
    first_unsound, scale,
};

/// Plays a network, and stands without it: one call a control step. While the robot walks it allocates nothing.
#[derive(Debug, Clone)]
pub struct Controller {
    network: Arc<Network>,
    history: History,
    setpoint: Option<Setpoint>,
    clock: Clock,
    standing: Standing,
    last_action: [f64; MOVED],
    observation: Vec<f32>,
    scratch: Scratch,
    bends_low: bool,
    /// Command by which the robot already stands before the first control step.
    stands_by: Option<BodyCommand>,
}

/// Heights of the pelvis, m, and pitches of the torso, rad, at which a robot is kept that stands without the network and may bend
/// low.
const LOW: ([f64; 2], [f64; 2]) = ([0.40, 0.79], [-0.1, 1.2]);

impl Controller {
    /// At the start of an episode.
    pub fn new(network: Arc<Network>) -> Self {
        Self {
            history: History::new(network.contract().frames),
            setpoint: None,
            clock: Clock::default(),
            standing: network.standing().clone(),
            last_action: [0.0; MOVED],
            observation: vec![0.0; network.contract().layers[0]],
            scratch: network.scratch(),
            network,
            bends_low: false,
            stands_by: None,
        }
    }

    /// While it keeps the robot over its feet without the network, commands may bend it lower than the network can: to a height of
    /// 0.40 m and a pitch of 1.2 rad. The network takes over as before where the robot is pushed, and may not catch it there.
    #[must_use]
    pub fn bending_low(self) -> Self {
        Self { bends_low: true, ..self }
    }

    /// Begins with a robot that already stands as a command has it, perhaps bent: it stands by balance from the first control step on,
    /// until it is pushed too far or walks.
    pub fn stand_by(&mut self, command: BodyCommand) {
        self.stands_by = Some(command);
        self.standing.stand_at_once();
    }

    /// Never steps: it stands by balance from the first control step on, as on a platform that has no room for a step.
    #[must_use]
    pub fn without_steps(mut self) -> Self {
        self.standing.stand_alone();
        self
    }

    /// Forgets the episode that was played, before another one begins.
    pub fn restart(&mut self) {
        self.history.clear();
        self.setpoint = None;
        self.clock = Clock::default();
        self.standing.restart();
        self.last_action = [0.0; MOVED];
        self.stands_by = None;
    }

    /// Network, with its contract.
    pub fn network(&self) -> &Network {
        &self.network
    }

    /// Refuses a command outside of the range that the controller was trained for.
    ///
    /// # Errors
    /// [`WbcError::Command`], with the field's name.
    pub fn check(&self, command: &BodyCommand) -> Result<(), WbcError> {
        let ranges = self.network.contract().command_ranges(command.walks());
        let Some((index, value)) = command.outside(&ranges) else { return Ok(()) };
        let [low, high] = ranges[index];
        Err(WbcError::Command { field: BodyCommand::NAMES[index], value, low, high })
    }

    /// Takes what is sensed and commanded, and writes the targets of legs and waist, the first 15 joints, rad. Commands beyond
    /// the range count as its ends.
    ///
    /// # Errors
    /// [`WbcError::Sensed`]: an observation that lacks a term or is not finite; nothing is written then.
    pub fn step(&mut self, sensed: &Sensed<'_>, command: &BodyCommand, targets: &mut [f64]) -> Result<(), WbcError> {
        check_sensed(sensed)?;
        let command = self.within_range(command);
        let is_first = self.setpoint.is_none();
        let upright = BodyCommand { height: NOMINAL_HEIGHT, ..BodyCommand::default() };
        let BodyCommand { height, torso, .. } = self.stands_by.take().unwrap_or(upright);
        let start = || Setpoint::at(BodyCommand { height, torso, ..command });
        let setpoint = self.setpoint.get_or_insert_with(start);
        if !is_first {
            setpoint.advance(&command);
        }
        let setpoint = *setpoint;
        self.history.push(sensed, setpoint.now(), self.clock.signal(), &self.last_action, is_first);
        let stands = self.clock.stands();
        self.clock.advance(setpoint.now().walks());
        if !stands {
            self.standing.restart();
        } else if let Some(wanted) = self.standing.step(sensed, setpoint.now())? {
            let joints = &self.network.contract().joints;
            for (index, (last, target)) in self.last_action.iter_mut().zip(targets).enumerate() {
                *target = wanted[index];
                *last = ((*target - joints[index].q0) / scale(index)).clamp(-ACTION_CLAMP, ACTION_CLAMP);
            }
            return Ok(());
        }
        self.history.write(&mut self.observation);
        let mut action = [0.0; MOVED];
        self.network.run(&self.observation, &mut self.scratch, &mut action);
        let joints = &self.network.contract().joints;
        for (index, ((last, action), target)) in self.last_action.iter_mut().zip(action).zip(targets).enumerate() {
            *last = f64::from(action).clamp(-ACTION_CLAMP, ACTION_CLAMP);
            *target = joints[index].q0 + scale(index) * *last;
        }
        Ok(())
    }

    /// True if both feet stay down until a command to walk.
    pub fn stands(&self) -> bool {
        self.clock.stands()
    }

    /// Where the left foot is due in its stride; see [`Clock::stride`].
    pub fn stride(&self) -> f64 {
        self.clock.stride()
    }

    /// True if it keeps the robot over its feet where they are, without the network.
    pub fn is_standing(&self) -> bool {
        self.standing.has_taken_over()
    }

    fn within_range(&self, command: &BodyCommand) -> BodyCommand {
        let contract = self.network.contract();
        let within = |value: f64, [low, high]: [f64; 2]| if value.is_finite() { value.clamp(low, high) } else { 0.0 };
        let (numbers, ranges) = (command.numbers(), contract.command_ranges(false));
        let mut clamped = BodyCommand::from(std::array::from_fn(|index| within(numbers[index], ranges[index])));
        clamped.height = within(command.height, contract.command_ranges(clamped.walks())[3]);
        if self.bends_low && self.is_standing() && !clamped.walks() {
            clamped.height = within(command.height, LOW.0);
            clamped.torso[1] = within(command.torso[1], LOW.1);
        }
        clamped
    }
}

fn check_sensed(sensed: &Sensed<'_>) -> Result<(), WbcError> {
    let height = [sensed.base_height];
    let terms: [(&'static str, &[f64], usize); 6] = [
        ("base_angular_velocity", &sensed.base_angular_velocity, 3),
        ("projected_gravity", &sensed.projected_gravity, 3),
        ("base_linear_velocity", &sensed.base_linear_velocity, 3),
        ("base_height", &height, 1),
        ("joint_position", sensed.joint_position, BODY),
        ("joint_velocity", sensed.joint_velocity, MOVED),
    ];
    match first_unsound(&terms) {
        Some((term, problem)) => Err(WbcError::Sensed { term, problem }),
        None => Ok(()),
    }
}
