//! What the robot senses of its own body: a row, and uniform noise.

use fiatlux_rules::Row;
use nalgebra::Vector3;

use crate::noise::{Noise, NoiseSeed};

/// What the robot senses of its own body in one row. The pelvis frame is the pelvis link's.
#[derive(Debug, Clone, PartialEq)]
pub struct Proprioception {
    /// Angular velocity of the pelvis, pelvis frame, rad/s.
    pub base_angular_velocity: [f64; 3],
    /// Direction of gravity, pelvis frame: a unit vector, (0, 0, -1) upright, before noise.
    pub projected_gravity: [f64; 3],
    /// Velocity of the pelvis link's origin, pelvis frame, m/s.
    pub base_linear_velocity: [f64; 3],
    /// Height of the pelvis link's origin in the world, m.
    pub base_height: f64,
    /// Joint positions less those of the standing posture q0, public order, rad.
    pub joint_position: Vec<f64>,
    /// Joint velocities, public order, rad/s.
    pub joint_velocity: Vec<f64>,
}

impl Proprioception {
    /// All numbers 0, for a robot with that many joints.
    pub fn zeros(joints: usize) -> Self {
        Self {
            base_angular_velocity: [0.0; 3],
            projected_gravity: [0.0; 3],
            base_linear_velocity: [0.0; 3],
            base_height: 0.0,
            joint_position: vec![0.0; joints],
            joint_velocity: vec![0.0; joints],
        }
    }

    /// Reads off a row, without noise, what a robot of that standing posture senses.
    pub(crate) fn measure(&mut self, row: &Row, q0: &[f64]) {
        let world_from_pelvis = &row.robot.pose.rotation;
        let in_pelvis = |vector: &Vector3<f64>| world_from_pelvis.inverse_transform_vector(vector).into();
        self.base_angular_velocity = in_pelvis(&row.robot.angular_velocity);
        self.projected_gravity = in_pelvis(&-Vector3::z());
        self.base_linear_velocity = in_pelvis(&row.robot.linear_velocity);
        self.base_height = row.robot.pose.translation.z;
        self.joint_position.clear();
        self.joint_position.extend(row.joint_position.iter().zip(q0).map(|(q, q0)| q - q0));
        self.joint_velocity.clone_from(&row.joint_velocity);
    }

    pub(crate) fn add_noise(&mut self, noise: &mut Noise, step: u64) {
        let terms: [&mut [f64]; 6] = [
            &mut self.base_angular_velocity,
            &mut self.projected_gravity,
            &mut self.base_linear_velocity,
            std::slice::from_mut(&mut self.base_height),
            &mut self.joint_position,
            &mut self.joint_velocity,
        ];
        for ((term, half_width), values) in NOISE.into_iter().zip(terms) {
            noise.add(term, half_width, step, values);
        }
    }
}

/// Turns the rows of one episode into what its robot senses. The noise of row k is the same whatever the rows hold, and
/// whichever of them are observed.
#[derive(Debug, Clone)]
pub struct Observer {
    q0: Vec<f64>,
    noise: Noise,
}

impl Observer {
    /// An observer that has seen nothing; `q0` is the robot's standing posture, rad. Without a seed it adds no noise.
    pub fn new(q0: Vec<f64>, noise: Option<NoiseSeed>) -> Self {
        Self { q0, noise: Noise::new(noise) }
    }

    /// Begins another episode of the same robot.
    pub fn restart(&mut self, noise: Option<NoiseSeed>) {
        self.noise.restart(noise);
    }

    /// Writes what the robot senses in a row.
    pub fn observe(&mut self, row: &Row, sensed: &mut Proprioception) {
        sensed.measure(row, &self.q0);
        sensed.add_noise(&mut self.noise, row.step);
    }
}

/// Name and half-width of the uniform noise of each term, in the term's unit; these are the published ones.
pub(crate) const NOISE: [(&str, f64); 6] = [
    ("base_angular_velocity", 0.2),
    ("projected_gravity", 0.05),
    ("base_linear_velocity", 0.1),
    ("base_height", 0.05),
    ("joint_position", 0.01),
    ("joint_velocity", 1.5),
];

#[cfg(test)]
mod tests;
