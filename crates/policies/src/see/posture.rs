//! Angles of joints that move slowly, with less noise than they are sensed with.

use fiatlux_rules::CONTROL_DT;

/// Time in which a drive follows its target, and that over which it is seen by how much it stays off, s.
const FOLLOWS: f64 = 0.12;
const AVERAGED: f64 = 0.5;

/// Joints as their drives have them: they follow their targets, and stay off them by what they bear.
#[derive(Debug, Default)]
pub(super) struct Posture {
    /// Of each joint, where its drive has followed to, and by how much the joint is off that, rad.
    joints: Vec<[f64; 2]>,
    angles: Vec<f64>,
}

impl Posture {
    /// Angles of the joints, rad.
    pub fn angles(&self) -> &[f64] {
        &self.angles
    }

    /// Goes on by a control step, with the angles as they are sensed, and the targets of the step before, rad.
    pub fn step(&mut self, sensed: &[f64], targets: &[f64]) {
        if self.joints.len() != sensed.len() {
            self.joints = sensed.iter().zip(targets).map(|(sensed, target)| [*target, sensed - target]).collect();
        }
        self.angles.clear();
        for ((joint, sensed), target) in self.joints.iter_mut().zip(sensed).zip(targets) {
            let [followed, off] = joint;
            *followed += (target - *followed) * (CONTROL_DT / FOLLOWS);
            *off += (sensed - *followed - *off) * (CONTROL_DT / AVERAGED);
            self.angles.push(*followed + *off);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_has_a_tenth_of_the_noise_and_keeps_up_with_its_drive() {
        let (mut posture, mut followed, mut squares) = (Posture::default(), 0.0, [0.0; 2]);
        for step in 0..2000_u32 {
            // A drive that is 0.03 rad off its target by what it bears, whose target moves by 0.2 rad/s to and fro.
            let target = 0.1 * libm::sin(0.02 * CONTROL_DT * f64::from(step) * 100.0);
            followed += (target - followed) * (CONTROL_DT / FOLLOWS);
            let (truth, noise) =
                (followed - 0.03, 0.01 * f64::from(step.wrapping_mul(2_654_435_761) >> 16) / 32768.0 - 0.01);
            posture.step(&[truth + noise], &[target]);
            if step > 200 {
                squares[0] += noise * noise;
                squares[1] += (posture.angles()[0] - truth).powi(2);
            }
        }
        let [noise, left] = squares.map(|sum| libm::sqrt(sum / 1800.0));
        assert!(noise > 0.005 && left < 0.2 * noise, "{left} rad of {noise}");
    }
}
