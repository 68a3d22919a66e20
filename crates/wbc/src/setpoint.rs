//! A command as it sets in.

use fiatlux_proto::BodyCommand;
use serde::{Deserialize, Serialize};

use crate::CONTROL_DT;

/// Rates at which height, m/s, and torso, rad/s, follow the command.
const HEIGHT_RATE: f64 = 0.3;
const TORSO_RATE: f64 = 1.0;

/// A command as it sets in: velocities at once, height and torso at a bounded rate.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Setpoint {
    now: BodyCommand,
}

impl Setpoint {
    /// Starts at a command.
    pub fn at(command: BodyCommand) -> Self {
        let mut setpoint = Self { now: command };
        setpoint.advance(&command);
        setpoint
    }

    /// Goes on by a control step towards a command.
    pub fn advance(&mut self, command: &BodyCommand) {
        self.now.velocity = if command.walks() { command.velocity } else { [0.0; 3] };
        self.now.height = towards(self.now.height, command.height, HEIGHT_RATE);
        for (now, wanted) in self.now.torso.iter_mut().zip(command.torso) {
            *now = towards(*now, wanted, TORSO_RATE);
        }
    }

    /// Setpoint of this control step.
    pub fn now(&self) -> &BodyCommand {
        &self.now
    }
}

/// A step of [`CONTROL_DT`] at a bounded rate.
pub(crate) fn towards(from: f64, to: f64, rate: f64) -> f64 {
    from + (to - from).clamp(-rate * CONTROL_DT, rate * CONTROL_DT)
}
