//! Proprioception: a row with uniform noise.

use fiatlux_proto::Proprioception;
use fiatlux_rules::Row;
use nalgebra::Vector3;

use crate::noise::{Noise, NoiseSeed};

/// Writes what a robot of that standing posture senses in a row, with noise.
pub(crate) fn sense(row: &Row, q0: &[f64], noise: &mut Noise, sensed: &mut Proprioception) {
    let world_from_pelvis = &row.robot.pose.rotation;
    let in_pelvis = |vector: &Vector3<f64>| world_from_pelvis.inverse_transform_vector(vector).into();
    sensed.base_angular_velocity = in_pelvis(&row.robot.angular_velocity);
    sensed.projected_gravity = in_pelvis(&-Vector3::z());
    sensed.base_linear_velocity = in_pelvis(&row.robot.linear_velocity);
    sensed.base_height = row.robot.pose.translation.z;
    sensed.joint_position.clear();
    sensed.joint_position.extend(row.joint_position.iter().zip(q0).map(|(q, q0)| q - q0));
    sensed.joint_velocity.clone_from(&row.joint_velocity);
    let terms: [&mut [f64]; 6] = [
        &mut sensed.base_angular_velocity,
        &mut sensed.projected_gravity,
        &mut sensed.base_linear_velocity,
        std::slice::from_mut(&mut sensed.base_height),
        &mut sensed.joint_position,
        &mut sensed.joint_velocity,
    ];
    for ((term, half_width), values) in NOISE.into_iter().zip(terms) {
        noise.add(term, half_width, row.step, values);
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
        sense(row, &self.q0, &mut self.noise, sensed);
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
