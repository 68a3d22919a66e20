//! Proprioception, as sensors, messages, controllers and policies share it.

use crate::{NOMINAL_HEIGHT, v3};

/// Readings of a robot's own body in one row. The pelvis frame is the pelvis link's. `J` has the numbers of the joints: a list
/// of its own, or a slice of another one.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Proprioception<J = Vec<f64>> {
    /// Angular velocity of the pelvis, pelvis frame, rad/s.
    pub base_angular_velocity: [f64; 3],
    /// Direction of gravity, pelvis frame: a unit vector, (0, 0, -1) upright, before noise.
    pub projected_gravity: [f64; 3],
    /// Velocity of the pelvis link's origin, pelvis frame, m/s.
    pub base_linear_velocity: [f64; 3],
    /// Height of the pelvis link's origin in the world, m.
    pub base_height: f64,
    /// Joint positions less those of the standing posture q0, public order, rad.
    pub joint_position: J,
    /// Joint velocities, public order, rad/s.
    pub joint_velocity: J,
}

impl Proprioception {
    /// All numbers 0, for a robot with that many joints.
    pub fn zeros(joints: usize) -> Self {
        Self { joint_position: vec![0.0; joints], joint_velocity: vec![0.0; joints], ..Self::default() }
    }

    /// The same with slices of its lists.
    pub fn view(&self) -> Proprioception<&[f64]> {
        let Self { base_angular_velocity, projected_gravity, base_linear_velocity, base_height, .. } = *self;
        Proprioception {
            base_angular_velocity,
            projected_gravity,
            base_linear_velocity,
            base_height,
            joint_position: &self.joint_position,
            joint_velocity: &self.joint_velocity,
        }
    }

    /// Reads a message into its lists. A vector that is too short becomes NaN, and a list of joints stays short, so that a
    /// controller refuses it by its name.
    pub fn read(&mut self, message: &v3::Proprioception) -> Proprioception<&[f64]> {
        let copy = |to: &mut Vec<f64>, from: &[f32]| {
            to.clear();
            to.extend(from.iter().map(|number| f64::from(*number)));
        };
        copy(&mut self.joint_position, &message.joint_position);
        copy(&mut self.joint_velocity, &message.joint_velocity);
        self.base_angular_velocity = vector(&message.base_angular_velocity);
        self.projected_gravity = vector(&message.projected_gravity);
        self.base_linear_velocity = vector(&message.base_linear_velocity);
        self.base_height = f64::from(message.base_height);
        self.view()
    }
}

impl<'a> Proprioception<&'a [f64]> {
    /// Of a robot that stands upright and at rest, with these positions and velocities of its joints.
    pub fn upright(joint_position: &'a [f64], joint_velocity: &'a [f64]) -> Self {
        let base = Self { projected_gravity: [0.0, 0.0, -1.0], base_height: NOMINAL_HEIGHT, ..Self::default() };
        Self { joint_position, joint_velocity, ..base }
    }
}

impl From<&Proprioception> for v3::Proprioception {
    fn from(sensed: &Proprioception) -> Self {
        let singles = |numbers: &[f64]| numbers.iter().map(|number| *number as f32).collect();
        Self {
            base_angular_velocity: singles(&sensed.base_angular_velocity),
            projected_gravity: singles(&sensed.projected_gravity),
            base_linear_velocity: singles(&sensed.base_linear_velocity),
            base_height: sensed.base_height as f32,
            joint_position: singles(&sensed.joint_position),
            joint_velocity: singles(&sensed.joint_velocity),
        }
    }
}

fn vector(term: &[f32]) -> [f64; 3] {
    [0, 1, 2].map(|axis| term.get(axis).map_or(f64::NAN, |&value| f64::from(value)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_message_holds_every_term() {
        let sensed = Proprioception {
            base_angular_velocity: [1.0, 2.0, 3.0],
            projected_gravity: [4.0, 5.0, 6.0],
            base_linear_velocity: [7.0, 8.0, 9.0],
            base_height: 10.0,
            joint_position: vec![11.0, 12.0],
            joint_velocity: vec![13.0, 14.0],
        };
        let message = v3::Proprioception::from(&sensed);
        // Its old content is gone, whatever its length.
        let mut read = Proprioception::zeros(5);
        assert_eq!(read.read(&message), sensed.view());
        assert_eq!(read, sensed);
    }

    #[test]
    fn a_vector_that_is_too_short_is_nan() {
        let message = v3::Proprioception { projected_gravity: vec![0.5, 0.5], ..v3::Proprioception::default() };
        let mut sensed = Proprioception::default();
        let gravity = sensed.read(&message).projected_gravity;
        assert!(gravity[..2] == [0.5; 2] && gravity[2].is_nan(), "{gravity:?}");
    }
}
