//! Velocities that bring a robot to a place.

use fiatlux_rules::CONTROL_DT;
use nalgebra::{Isometry3, UnitQuaternion, Vector2, Vector3};

use crate::path::wrapped;

/// Gain of a velocity over the distance or the turn that is left, 1/s: a robot slows down where its largest speed is more than this
/// times what is left.
pub const GAIN: f64 = 1.5;
/// Least speed of steps, m/s, and largest rate of turning with them, rad/s.
const MIN_SPEED: f64 = 0.1;
const TURN_RATE: f64 = 0.4;

/// Largest changes of a velocity, so that what a hand holds is not jerked.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Slew {
    /// Ahead and to the left, m/s^2.
    pub linear: f64,
    /// About the vertical, rad/s^2.
    pub turn: f64,
}

impl Slew {
    /// A velocity, m/s and rad/s, a control step nearer to another one.
    pub fn step(self, velocity: [f64; 3], wanted: [f64; 3]) -> [f64; 3] {
        let rates = [self.linear, self.linear, self.turn];
        [0, 1, 2].map(|axis| towards(velocity[axis], wanted[axis], rates[axis]))
    }
}

/// A number a control step nearer to another one, at a rate in its unit per second.
pub fn towards(now: f64, to: f64, rate: f64) -> f64 {
    now + (to - now).clamp(-rate * CONTROL_DT, rate * CONTROL_DT)
}

/// Turn about the vertical of a pose's x axis, rad.
pub fn heading(pose: &Isometry3<f64>) -> f64 {
    let ahead = pose.rotation * Vector3::x();
    libm::atan2(ahead.y, ahead.x)
}

/// Steps towards a place.
#[derive(Debug, Clone, Copy)]
pub struct Steps {
    /// Velocity to command, m/s and rad/s.
    pub velocity: [f64; 3],
    /// Distance of the pelvis from the place, m.
    pub distance: f64,
}

/// Steps to where the pelvis is at a place and the robot looks in a direction, rad; `fastest` in m/s.
pub fn steps_to(pelvis: &Isometry3<f64>, place: &Vector2<f64>, facing: f64, fastest: f64) -> Steps {
    let away = place - pelvis.translation.vector.xy();
    let looks = heading(pelvis);
    let left = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -looks) * Vector3::new(away.x, away.y, 0.0);
    let distance = left.norm();
    let speed = (GAIN * distance).clamp(MIN_SPEED, fastest);
    let velocity = left * (speed / distance.max(1e-6));
    let turn = (GAIN * wrapped(facing - looks)).clamp(-TURN_RATE, TURN_RATE);
    Steps { velocity: [velocity.x, velocity.y, turn], distance }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::FRAC_PI_2;

    use super::*;

    /// A robot that looks to the left of its way steps to its right, and slows down where it is near.
    #[test]
    fn steps_are_seen_from_the_robot() {
        let pelvis = Isometry3::new(Vector3::new(1.0, 0.0, 0.8), Vector3::z() * FRAC_PI_2);
        let Steps { velocity, distance } = steps_to(&pelvis, &Vector2::new(2.0, 0.0), FRAC_PI_2 - 0.1, 0.3);
        assert!((distance - 1.0).abs() < 1e-12);
        let expected = [0.0, -0.3, -0.15];
        assert!(velocity.iter().zip(expected).all(|(now, expected)| (now - expected).abs() < 1e-12), "{velocity:?}");
        let near = steps_to(&pelvis, &Vector2::new(1.1, 0.0), FRAC_PI_2, 0.3);
        assert!((near.velocity[1] + 0.15).abs() < 1e-12, "{near:?}");
    }

    #[test]
    fn a_velocity_changes_no_faster_than_its_slew() {
        let slew = Slew { linear: 0.5, turn: 1.0 };
        let next = slew.step([0.0, 0.2, 0.0], [1.0, 0.2, -0.01]);
        let expected = [0.01, 0.2, -0.01];
        assert!(next.iter().zip(expected).all(|(now, expected)| (now - expected).abs() < 1e-12), "{next:?}");
    }
}
