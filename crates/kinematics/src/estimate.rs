//! Angles and speeds of joints from noisy angles.

use fiatlux_dynamics::State;

/// Parts of the difference between sensed and expected angle that angle and, per control step, speed take over: those of a
/// steady Kalman filter for noise of 0.01 rad and expected accelerations that are wrong by some 0.5 rad/s^2.
const SHARES: (f64, f64) = (0.23, 0.03);
/// Control step, s.
const DT: f64 = 0.02;

/// Expects where joints will be from their accelerations, and corrects that by what is sensed. Sensed speeds are noisier than
/// those that follow from the angles, and are not used.
#[derive(Debug, Clone)]
pub struct JointFilter {
    /// Places of each joint in `qpos` and `qvel`.
    joints: Vec<(usize, usize)>,
    is_first: bool,
}

impl JointFilter {
    /// For joints at these places in `qpos` and `qvel`.
    pub fn new(joints: impl IntoIterator<Item = (usize, usize)>) -> Self {
        Self { joints: joints.into_iter().collect(), is_first: true }
    }

    /// Takes over the next angle of the next joint into `state`, which has those of the step before. Accelerations are
    /// those of the step before, in the order of `qvel`.
    pub fn step(&mut self, angles: &[f64], accelerations: &[f64], state: &mut State) {
        for ((qpos, dof), sensed) in self.joints.iter().zip(angles) {
            let (q, speed) = (&mut state.qpos[*qpos], &mut state.qvel[*dof]);
            if self.is_first {
                (*q, *speed) = (*sensed, 0.0);
                continue;
            }
            *q += (*speed + 0.5 * accelerations[*dof] * DT) * DT;
            *speed += accelerations[*dof] * DT;
            let surprise = sensed - *q;
            *q += SHARES.0 * surprise;
            *speed += SHARES.1 / DT * surprise;
        }
        self.is_first = false;
    }
}
