//! The decoder of GEAR-SONIC: moves all joints of the body by a token that stands for a motion.

use std::path::Path;

use fiatlux_wbc::Sensed;

use crate::model::Runner;
use crate::{BODY, DECODER, ForeignError, Model, TOKEN, Token, history, sensed, token};

pub(crate) const NAME: &str = "sonic";
const FRAMES: usize = 10;
/// Start of each block of the observation: token, angular velocity, positions, velocities, actions, gravity.
const ANGULAR_VELOCITY: usize = TOKEN;
const POSITION: usize = ANGULAR_VELOCITY + 3 * FRAMES;
const VELOCITY: usize = POSITION + BODY * FRAMES;
const ACTION: usize = VELOCITY + BODY * FRAMES;
const GRAVITY: usize = ACTION + BODY * FRAMES;
const INPUTS: usize = GRAVITY + 3 * FRAMES;

/// Index in our body of joint i of Isaac Lab, which orders the joints of a tree by depth.
const FROM_ISAAC: [usize; BODY] =
    [0, 6, 12, 1, 7, 13, 2, 8, 14, 3, 9, 15, 22, 4, 10, 16, 23, 5, 11, 17, 24, 18, 25, 19, 26, 20, 27, 21, 28];

/// Runs the decoder; call it once every control step of 20 ms.
#[derive(Debug)]
pub struct Sonic {
    decoder: Runner,
    /// The session's posture q0 minus the controller's, rad.
    offset: [f64; BODY],
    /// Blocks one after another, each with its oldest frame first.
    observation: [f32; INPUTS],
    /// The last action, in Isaac Lab's order.
    action: [f32; BODY],
}

impl Sonic {
    /// Reads `model_decoder.onnx` in a folder.
    pub fn read(folder: &Path) -> Result<Model, ForeignError> {
        DECODER.read(folder)
    }

    /// Starts an episode with a history at rest, upright and in the controller's posture. The session's joint positions
    /// are relative to `q0`, rad.
    pub fn new(decoder: &Model, q0: &[f64]) -> Result<Self, ForeignError> {
        let mut observation = [0.0; INPUTS];
        observation[GRAVITY..].iter_mut().skip(2).step_by(3).for_each(|down| *down = -1.0);
        Ok(Self {
            decoder: decoder.runner(),
            offset: sensed::offset(NAME, q0, default_angle)?,
            observation,
            action: [0.0; BODY],
        })
    }

    /// Takes sensor data and a token, and writes the targets of the first 29 joints (legs, waist and arms), rad.
    pub fn step(&mut self, sensed: &Sensed<'_>, meant: &Token, targets: &mut [f64]) -> Result<(), ForeignError> {
        sensed::check(NAME, sensed)?;
        token::check(meant)?;
        let position = |joint: usize| sensed.joint_position[joint] + self.offset[joint];
        let velocity = |joint: usize| sensed.joint_velocity[joint];
        self.observation[..TOKEN].copy_from_slice(meant);
        let mut push = |from: usize, to: usize, frame: usize, newest: &mut dyn Iterator<Item = f64>| {
            history::push(&mut self.observation[from..to], frame, newest);
        };
        push(ANGULAR_VELOCITY, POSITION, 3, &mut sensed.base_angular_velocity.into_iter());
        push(POSITION, VELOCITY, BODY, &mut FROM_ISAAC.into_iter().map(position));
        push(VELOCITY, ACTION, BODY, &mut FROM_ISAAC.into_iter().map(velocity));
        push(ACTION, GRAVITY, BODY, &mut self.action.into_iter().map(f64::from));
        push(GRAVITY, INPUTS, 3, &mut sensed.projected_gravity.into_iter());
        let ran = self.decoder.run(&self.observation, &mut self.action);
        ran.map_err(|problem| ForeignError::Run { controller: NAME, problem })?;
        for (joint, action) in FROM_ISAAC.into_iter().zip(self.action) {
            if let Some(target) = targets.get_mut(joint) {
                *target = default_angle(joint) + action_scale(joint) * f64::from(action);
            }
        }
        Ok(())
    }

    /// The decoder's observation in the last step.
    pub fn observation(&self) -> &[f32] {
        &self.observation
    }
}

/// Angle of a joint in the controller's posture, rad.
fn default_angle(joint: usize) -> f64 {
    match joint {
        0 | 6 => -0.312,
        3 | 9 => 0.669,
        4 | 10 => -0.363,
        15 | 22 => 0.2,
        16 => 0.2,
        23 => -0.2,
        18 | 25 => 0.6,
        _ => 0.0,
    }
}

/// Radians of joint target per unit of action: a quarter of a motor's effort over its stiffness, which is armature (2
/// pi 10 Hz)^2. The ankles, and roll and pitch of the waist, have two motors but the scale of one.
fn action_scale(joint: usize) -> f64 {
    /// Effort, N m, and armature, kg m^2, of the motors 7520-22, 7520-14, 5020 and 4010.
    const MOTORS: [(f64, f64); 4] = [(139.0, 0.025101925), (88.0, 0.01017752), (25.0, 0.003609725), (5.0, 0.00425)];
    const FREQUENCY: f64 = std::f64::consts::TAU * 10.0;
    let (effort, armature) = MOTORS[match joint {
        0 | 1 | 3 | 6 | 7 | 9 => 0,
        2 | 8 | 12 => 1,
        20 | 21 | 27 | 28 => 3,
        _ => 2,
    }];
    0.25 * effort / (armature * FREQUENCY * FREQUENCY)
}

#[cfg(test)]
mod tests {
    use super::{BODY, FROM_ISAAC, INPUTS, action_scale};

    /// The inverse, as its makers publish it: joint i of the body is this joint of Isaac Lab.
    const TO_ISAAC: [usize; BODY] =
        [0, 3, 6, 9, 13, 17, 1, 4, 7, 10, 14, 18, 2, 5, 8, 11, 15, 19, 21, 23, 25, 27, 12, 16, 20, 22, 24, 26, 28];

    #[test]
    fn orders_are_inverse_and_scales_are_the_published_ones() {
        for joint in 0..BODY {
            assert_eq!(FROM_ISAAC[TO_ISAAC[joint]], joint);
        }
        assert_eq!(INPUTS, 994);
        // Hip pitch, hip yaw, ankle pitch, waist roll, elbow, wrist yaw.
        for (joint, scale) in [(0, 0.35066), (2, 0.54755), (4, 0.43858), (13, 0.43858), (18, 0.43858), (28, 0.07450)] {
            assert!((action_scale(joint) - scale).abs() < 5e-6, "{joint}: {}", action_scale(joint));
        }
    }
}
