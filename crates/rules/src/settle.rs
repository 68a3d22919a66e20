//! Low-passed speeds of a pose, by which a bulb is judged to be settled.
//!
//! A bulb that the socket presses against its seat shows velocities of up to 0.1 m/s and 2 rad/s in single steps while
//! its pose stands still; speeds of the pose itself, low-passed, tell the two apart.

use nalgebra::{Isometry3, UnitQuaternion};
use serde::{Deserialize, Serialize};

use crate::row::CONTROL_DT;

/// Speed and turning speed of a pose, both low-passed.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct PoseSpeed {
    /// Speed of its position, m/s.
    pub linear: f64,
    /// Speed of its orientation, rad/s.
    pub angular: f64,
}

impl PoseSpeed {
    /// Advances by one control step: `s <- s + min(1, dt / time_constant) (|difference| / dt - s)`.
    #[must_use]
    pub fn advance(self, before: &Isometry3<f64>, after: &Isometry3<f64>, time_constant_s: f64) -> Self {
        let linear = (after.translation.vector - before.translation.vector).norm() / CONTROL_DT;
        let angular = angle(&(before.rotation.inverse() * after.rotation)) / CONTROL_DT;
        Self {
            linear: low_pass(self.linear, linear, time_constant_s),
            angular: low_pass(self.angular, angular, time_constant_s),
        }
    }
}

/// A speed, low-passed over one control step.
pub(crate) fn low_pass(old: f64, new: f64, time_constant_s: f64) -> f64 {
    // With a time constant of zero the speed is not filtered.
    let share = if time_constant_s > CONTROL_DT { CONTROL_DT / time_constant_s } else { 1.0 };
    old + share * (new - old)
}

/// Angle of a rotation, rad, exact for small ones too.
fn angle(rotation: &UnitQuaternion<f64>) -> f64 {
    2.0 * libm::atan2(rotation.imag().norm(), rotation.w.abs())
}

#[cfg(test)]
mod tests {
    use nalgebra::{Translation3, Vector3};

    use super::*;

    /// A steady motion's speeds approach their true values as 1 - 0.8^k.
    #[test]
    fn steady_motion() {
        let pose = |k: f64| {
            let rotation = UnitQuaternion::from_scaled_axis(Vector3::new(0.0, 0.006 * k, 0.0));
            Isometry3::from_parts(Translation3::new(0.002 * k, 0.0, 0.0), rotation)
        };
        let mut speed = PoseSpeed::default();
        for k in 1..=10 {
            speed = speed.advance(&pose(f64::from(k) - 1.0), &pose(f64::from(k)), 0.1);
            let share = 1.0 - libm::pow(0.8, f64::from(k));
            assert!((speed.linear - 0.1 * share).abs() < 1e-12, "{k}: {speed:?}");
            assert!((speed.angular - 0.3 * share).abs() < 1e-9, "{k}: {speed:?}");
        }
    }

    #[test]
    fn time_constant_of_zero() {
        let there = Isometry3::translation(0.0, 0.0, 0.001);
        let speed = PoseSpeed { linear: 7.0, angular: 7.0 }.advance(&Isometry3::identity(), &there, 0.0);
        assert!((speed.linear - 0.05).abs() < 1e-15 && speed.angular == 0.0, "{speed:?}");
    }
}
