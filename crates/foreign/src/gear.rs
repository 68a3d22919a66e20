//! GEAR's decoupled controller from NVlabs/GR00T-WholeBodyControl: one network for standing and one for walking move
//! legs and waist.

use std::fmt;
use std::path::Path;
use std::str::FromStr;

use fiatlux_wbc::{BodyCommand, MOVED, Sensed};

use crate::model::Runner;
use crate::{BODY, ForeignError, GEAR_FILES, Model, history, sensed};

/// Default command for the height of the pelvis, m.
pub const HEIGHT: f64 = 0.74;

pub(crate) const NAME: &str = "gear";
/// Size of a frame: command 3, height 1, torso 3, angular velocity 3, gravity 3, positions 29, velocities 29, action
/// 15.
const FRAME: usize = 86;
const FRAMES: usize = 6;
/// The standing network runs while the commanded velocity is shorter than this.
const STANDS_BELOW: f64 = 0.05;
/// Radians of joint target per unit of action.
const ACTION_SCALE: f64 = 0.25;
/// Factor on joint velocities.
const VELOCITY_SCALE: f64 = 0.05;

/// The public source to follow where two disagree.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Reading {
    /// The makers' configuration, `g1_gear_wbc.yaml` in NVlabs/GR00T-WholeBodyControl.
    #[default]
    Nvidia,
    /// The port in huggingface/lerobot, `unitree_g1/controllers/gr00t_locomotion.py`.
    Lerobot,
}

impl Reading {
    /// Factor on the base's angular velocity.
    pub fn angular_velocity_scale(self) -> f64 {
        match self {
            Self::Nvidia => 0.5,
            Self::Lerobot => 0.25,
        }
    }

    /// Factors on the commanded velocity: forwards, to the left, about the vertical.
    pub fn command_scale(self) -> [f64; 3] {
        match self {
            Self::Nvidia => [2.0, 2.0, 0.5],
            Self::Lerobot => [2.0, 2.0, 0.25],
        }
    }
}

impl fmt::Display for Reading {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Nvidia => "nvidia",
            Self::Lerobot => "lerobot",
        })
    }
}

impl FromStr for Reading {
    type Err = String;

    /// The error lists the known readings.
    fn from_str(name: &str) -> Result<Self, String> {
        [Self::Nvidia, Self::Lerobot]
            .into_iter()
            .find(|reading| reading.to_string() == name)
            .ok_or_else(|| format!("'{name}' is not a known reading; use nvidia or lerobot"))
    }
}

/// Runs the two networks; call it once every control step of 20 ms.
#[derive(Debug)]
pub struct Gear {
    stand: Runner,
    walk: Runner,
    reading: Reading,
    /// The session's posture q0 minus the controller's, rad.
    offset: [f64; BODY],
    /// All frames, oldest first.
    observation: [f32; FRAMES * FRAME],
    action: [f32; MOVED],
}

impl Gear {
    /// Reads the networks `Balance.onnx` and `Walk.onnx` in a folder.
    pub fn read(folder: &Path) -> Result<[Model; 2], ForeignError> {
        let [stand, walk] = GEAR_FILES;
        Ok([stand.read(folder)?, walk.read(folder)?])
    }

    /// Starts an episode. The session's joint positions are relative to `q0`, rad.
    pub fn new([stand, walk]: &[Model; 2], reading: Reading, q0: &[f64]) -> Result<Self, ForeignError> {
        Ok(Self {
            stand: stand.runner(),
            walk: walk.runner(),
            reading,
            offset: sensed::offset(NAME, q0, default_angle)?,
            observation: [0.0; FRAMES * FRAME],
            action: [0.0; MOVED],
        })
    }

    /// Takes sensor data and a command, and writes the targets of the first 15 joints (legs and waist), rad.
    pub fn step(
        &mut self,
        sensed: &Sensed<'_>,
        command: &BodyCommand,
        targets: &mut [f64],
    ) -> Result<(), ForeignError> {
        sensed::check(NAME, sensed)?;
        let mut numbers = BodyCommand::NAMES.into_iter().zip(command.numbers());
        if let Some((field, value)) = numbers.find(|(_, value)| !value.is_finite()) {
            return Err(ForeignError::Command { field, value });
        }
        let velocity = command.velocity;
        let scale = self.reading.angular_velocity_scale();
        let frame = (velocity.into_iter().zip(self.reading.command_scale()).map(|(number, scale)| number * scale))
            .chain([command.height])
            .chain(command.torso)
            .chain(sensed.base_angular_velocity.map(|number| number * scale))
            .chain(sensed.projected_gravity)
            .chain(sensed.joint_position.iter().zip(self.offset).map(|(position, offset)| position + offset))
            .chain(sensed.joint_velocity.iter().take(BODY).map(|number| number * VELOCITY_SCALE))
            .chain(self.action.map(f64::from));
        history::push(&mut self.observation, FRAME, frame);
        let length = velocity.iter().map(|number| number * number).sum::<f64>();
        let network = if length < STANDS_BELOW * STANDS_BELOW { &mut self.stand } else { &mut self.walk };
        let ran = network.run(&self.observation, &mut self.action);
        ran.map_err(|problem| ForeignError::Run { controller: NAME, problem })?;
        for (joint, (target, action)) in targets.iter_mut().zip(self.action).enumerate() {
            *target = default_angle(joint) + ACTION_SCALE * f64::from(action);
        }
        Ok(())
    }

    /// The network's observation in the last step.
    pub fn observation(&self) -> &[f32] {
        &self.observation
    }
}

/// Angle of a joint in the controller's posture, rad: hip pitch, knee and ankle pitch of both legs are bent.
fn default_angle(joint: usize) -> f64 {
    match joint {
        0 | 6 => -0.1,
        3 | 9 => 0.3,
        4 | 10 => -0.2,
        _ => 0.0,
    }
}
