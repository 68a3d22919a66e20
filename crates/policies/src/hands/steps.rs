//! Steps to a place on the floor.

use nalgebra::{Isometry3, UnitQuaternion, Vector2, Vector3};

use super::arm::heading;

/// Least speed of steps, m/s, gain of the speeds over the remaining distance, 1/s, and largest rate of turning, rad/s.
const MIN_SPEED: f64 = 0.1;
const GAIN: f64 = 1.5;
const TURN_RATE: f64 = 0.4;

/// Steps towards a place.
#[derive(Debug, Clone, Copy)]
pub(super) struct Steps {
    /// Velocity to command, m/s and rad/s.
    pub velocity: [f64; 3],
    /// Distance of the pelvis from the place, m.
    pub distance: f64,
}

/// Steps to where the pelvis is at a place and the robot looks in a direction, rad; `fastest` in m/s.
pub(super) fn steps_to(pelvis: &Isometry3<f64>, place: &Vector2<f64>, facing: f64, fastest: f64) -> Steps {
    let away = place - pelvis.translation.vector.xy();
    let looks = heading(pelvis);
    let left = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -looks) * Vector3::new(away.x, away.y, 0.0);
    let distance = left.norm();
    let speed = (GAIN * distance).clamp(MIN_SPEED, fastest);
    let velocity = left * (speed / distance.max(1e-6));
    let turn = (GAIN * angle(facing - looks)).clamp(-TURN_RATE, TURN_RATE);
    Steps { velocity: [velocity.x, velocity.y, turn], distance }
}

/// The same angle between -pi and pi, rad.
pub(super) fn angle(angle: f64) -> f64 {
    libm::atan2(libm::sin(angle), libm::cos(angle))
}
