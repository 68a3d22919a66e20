//! What the controller is asked for.

use serde::{Deserialize, Serialize};

use crate::CONTROL_DT;

/// Height of the pelvis that a robot walks at unless it is told otherwise, m.
pub const NOMINAL_HEIGHT: f64 = 0.75;
/// Velocities below these ask to stand: m/s, m/s, rad/s.
const STANDS_BELOW: [f64; 3] = [0.05, 0.05, 0.05];
/// How fast height, m/s, and torso, rad/s, follow the command.
const HEIGHT_RATE: f64 = 0.3;
const TORSO_RATE: f64 = 1.0;

/// A command: velocity, height, and how the torso leans.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Command {
    /// Of the pelvis, forwards and left, m/s, and about the vertical, rad/s.
    pub velocity: [f64; 3],
    /// Of the pelvis above the floor, m.
    pub height: f64,
    /// Roll, pitch and yaw of the torso, rad, from axes that stand upright and point where the pelvis points.
    pub torso: [f64; 3],
}

impl Default for Command {
    /// Standing upright at the nominal height.
    fn default() -> Self {
        Self { velocity: [0.0; 3], height: NOMINAL_HEIGHT, torso: [0.0; 3] }
    }
}

impl Command {
    /// Whether it asks for steps.
    pub fn walks(&self) -> bool {
        self.velocity.iter().zip(STANDS_BELOW).any(|(velocity, least)| velocity.abs() >= least)
    }

    /// Names of its [numbers](Command::numbers).
    pub const NAMES: [&str; 7] = ["vx", "vy", "wz", "height", "roll", "pitch", "yaw"];

    /// As the controller observes it.
    pub fn numbers(&self) -> [f64; 7] {
        let ([vx, vy, wz], [roll, pitch, yaw]) = (self.velocity, self.torso);
        [vx, vy, wz, self.height, roll, pitch, yaw]
    }
}

/// A command as it sets in: velocities at once, height and torso at a bounded rate.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Setpoint {
    now: Command,
}

impl Setpoint {
    /// Starts at a command.
    pub fn at(command: Command) -> Self {
        let mut setpoint = Self { now: command };
        setpoint.advance(&command);
        setpoint
    }

    /// Goes on by a control step towards a command.
    pub fn advance(&mut self, command: &Command) {
        self.now.velocity = if command.walks() { command.velocity } else { [0.0; 3] };
        self.now.height = towards(self.now.height, command.height, HEIGHT_RATE);
        for (now, wanted) in self.now.torso.iter_mut().zip(command.torso) {
            *now = towards(*now, wanted, TORSO_RATE);
        }
    }

    /// What holds in this control step.
    pub fn now(&self) -> &Command {
        &self.now
    }
}

/// A step of [`CONTROL_DT`] at a bounded rate.
pub(crate) fn towards(from: f64, to: f64, rate: f64) -> f64 {
    from + (to - from).clamp(-rate * CONTROL_DT, rate * CONTROL_DT)
}
