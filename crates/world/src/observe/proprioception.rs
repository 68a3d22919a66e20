//! What the robot senses of its own body: a row, and uniform noise.

use fiatlux_rules::Row;
use nalgebra::Vector3;

use super::ObservationTerm;
use super::table::{
    BASE_ANGULAR_VELOCITY, BASE_HEIGHT, BASE_LINEAR_VELOCITY, JOINT_POSITION, JOINT_VELOCITY, PROJECTED_GRAVITY,
};
use crate::{Random, Stream};

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

/// Which episode's noise is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct NoiseSeed {
    /// Seed.
    pub seed: u64,
    /// Episode.
    pub episode: u64,
}

impl Proprioception {
    /// All numbers 0, for a robot of so many joints.
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
}

/// Turns the rows of one episode into what its robot senses.
///
/// Each term has its own random stream, of which every observation takes the same count: the noise of the k-th
/// observation is the same whatever the rows hold.
#[derive(Debug, Clone)]
pub struct Observer {
    q0: Vec<f64>,
    noise: Option<Noise>,
}

impl Observer {
    /// An observer that has seen nothing; `q0` is the robot's standing posture, rad. Without a seed it adds no noise.
    pub fn new(q0: Vec<f64>, noise: Option<NoiseSeed>) -> Self {
        Self { q0, noise: noise.map(Noise::new) }
    }

    /// Writes the next observation.
    pub fn observe(&mut self, row: &Row, sensed: &mut Proprioception) {
        let world_from_pelvis = &row.robot.pose.rotation;
        let in_pelvis = |vector: &Vector3<f64>| world_from_pelvis.inverse_transform_vector(vector).into();
        sensed.base_angular_velocity = in_pelvis(&row.robot.angular_velocity);
        sensed.projected_gravity = in_pelvis(&-Vector3::z());
        sensed.base_linear_velocity = in_pelvis(&row.robot.linear_velocity);
        sensed.base_height = row.robot.pose.translation.z;
        sensed.joint_position.clear();
        sensed.joint_position.extend(row.joint_position.iter().zip(&self.q0).map(|(q, q0)| q - q0));
        sensed.joint_velocity.clone_from(&row.joint_velocity);
        if let Some(noise) = &mut self.noise {
            noise.add_to(sensed);
        }
    }
}

/// The streams of all terms, each with its half-width. A term without noise draws nothing.
#[derive(Debug, Clone)]
struct Noise {
    angular_velocity: TermNoise,
    gravity: TermNoise,
    linear_velocity: TermNoise,
    height: TermNoise,
    joint_position: TermNoise,
    joint_velocity: TermNoise,
}

#[derive(Debug, Clone)]
struct TermNoise {
    random: Random,
    half_width: f64,
}

impl TermNoise {
    fn add_to(&mut self, values: &mut [f64]) {
        for value in values {
            *value += self.random.uniform(-self.half_width, self.half_width);
        }
    }
}

impl Noise {
    fn new(NoiseSeed { seed, episode }: NoiseSeed) -> Self {
        let of = |term: &ObservationTerm| TermNoise {
            random: Random::of_term(Stream::Noise, term.name, seed, episode),
            half_width: term.noise,
        };
        Self {
            angular_velocity: of(&BASE_ANGULAR_VELOCITY),
            gravity: of(&PROJECTED_GRAVITY),
            linear_velocity: of(&BASE_LINEAR_VELOCITY),
            height: of(&BASE_HEIGHT),
            joint_position: of(&JOINT_POSITION),
            joint_velocity: of(&JOINT_VELOCITY),
        }
    }

    fn add_to(&mut self, sensed: &mut Proprioception) {
        self.angular_velocity.add_to(&mut sensed.base_angular_velocity);
        self.gravity.add_to(&mut sensed.projected_gravity);
        self.linear_velocity.add_to(&mut sensed.base_linear_velocity);
        self.height.add_to(std::slice::from_mut(&mut sensed.base_height));
        self.joint_position.add_to(&mut sensed.joint_position);
        self.joint_velocity.add_to(&mut sensed.joint_velocity);
    }
}

#[cfg(test)]
mod tests;
