//! Free arms, which hang and swing as the legs walk.

use crate::setpoint::towards;
use crate::{ARMS, BodyCommand, CONTROL_DT, MOVED};

/// Shoulder pitch, shoulder roll and elbow in an arm.
const JOINTS: [usize; 3] = [0, 1, 3];
/// Posture of a hanging left arm, rad: next to the thigh, the forearm down. Turns about the forward axis are mirrored on the
/// right.
const HANGS: [f64; 3] = [0.15, 0.2, 0.8];
/// Rate at which it comes to hang, rad/s.
const HANG_RATE: f64 = 1.0;
/// Swing of the shoulder's pitch for a speed forwards, rad s/m, and the widest, rad: as fast as arms moved in training, 2 rad/s.
const SWING: [f64; 2] = [0.5, 0.24];
/// Swing of each joint in that of the shoulder's pitch: the elbow bends as the arm comes forwards.
const SHARE: [f64; 3] = [-1.0, 0.0, -0.5];
/// Part of the swing while the other hand is not free.
const LOADED_SHARE: f64 = 0.5;
/// Time constant with which the swing follows the speed, s.
const FOLLOWS_S: f64 = 0.4;

/// Writes the targets of free arms: once the robot walks they hang, and swing against the leg on their side, wider the faster it
/// goes. An arm that is not free stays as it is.
#[derive(Debug, Clone)]
pub struct Swing {
    /// Of each arm, left first: where its joints go without the swing, rad, and the swing of the shoulder's pitch, rad.
    rest: [[f64; 3]; 2],
    width: [f64; 2],
}

impl Swing {
    /// Begins with the arms where their targets are. Targets that are missing are left out, here and in each step.
    pub fn new(targets: &[f64]) -> Self {
        let start = |side, joint| targets.get(index(side, joint)).copied().unwrap_or_default();
        Self { rest: [0, 1].map(|side| JOINTS.map(|joint| start(side, joint))), width: [0.0; 2] }
    }

    /// Goes on by a control step of a controller with this command. `stride` is [`Controller::stride`]; `is_free` says of each
    /// hand, left first, that it holds nothing.
    ///
    /// [`Controller::stride`]: crate::Controller::stride
    pub fn step(&mut self, command: &BodyCommand, stride: f64, is_free: [bool; 2], targets: &mut [f64]) {
        let (walks, [speed, ..]) = (command.walks(), command.velocity);
        for side in 0..2 {
            let share = if is_free[1 - side] { 1.0 } else { LOADED_SHARE };
            let wanted = if is_free[side] { share * (SWING[0] * speed).clamp(-SWING[1], SWING[1]) } else { 0.0 };
            self.width[side] += (wanted - self.width[side]) * (CONTROL_DT / FOLLOWS_S);
            let [out, back] = if side == 0 { [1.0, stride] } else { [-1.0, -stride] };
            for (part, rest) in self.rest[side].iter_mut().enumerate() {
                let hangs = if part == 1 { out * HANGS[part] } else { HANGS[part] };
                if walks && is_free[side] {
                    *rest = towards(*rest, hangs, HANG_RATE);
                }
                if let Some(target) = targets.get_mut(index(side, JOINTS[part])) {
                    *target = *rest + SHARE[part] * back * self.width[side];
                }
            }
        }
    }
}

fn index(side: usize, joint: usize) -> usize {
    MOVED + side * (ARMS / 2) + joint
}
