//! What the robot senses of its own body: a row, and uniform noise.
//!
//! Noise half-widths are those of the published `FIATLUX-Replace-v0` (`replace_env_cfg`, observation terms).

use fiatlux_rules::{JOINTS, Row};
use nalgebra::Vector3;

use crate::{Random, Stream};

/// Half-width of the noise of the base angular velocity, rad/s.
const ANGULAR_VELOCITY_NOISE: f64 = 0.2;
/// Half-width of the noise of the gravity direction.
const GRAVITY_NOISE: f64 = 0.05;
/// Half-width of the noise of the base linear velocity, m/s.
const LINEAR_VELOCITY_NOISE: f64 = 0.1;
/// Half-width of the noise of the base height, m.
const HEIGHT_NOISE: f64 = 0.05;
/// Half-width of the noise of the joint positions, rad.
const JOINT_POSITION_NOISE: f64 = 0.01;
/// Half-width of the noise of the joint velocities, rad/s.
const JOINT_VELOCITY_NOISE: f64 = 1.5;

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
    pub joint_position: [f64; JOINTS],
    /// Joint velocities, public order, rad/s.
    pub joint_velocity: [f64; JOINTS],
}

/// Which episode's noise is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct NoiseSeed {
    /// Layout seed.
    pub seed: u64,
    /// Episode.
    pub episode: u64,
}

/// Turns the rows of one episode into what its robot senses.
///
/// Each term has its own random stream, of which every observation takes the same count: the noise of the k-th
/// observation is the same whatever the rows hold.
#[derive(Debug, Clone)]
pub struct Observer {
    q0: [f64; JOINTS],
    noise: Option<Noise>,
}

impl Observer {
    /// An observer that has seen nothing; `q0` is the robot's standing posture, rad. Without a seed it adds no noise.
    pub fn new(q0: [f64; JOINTS], noise: Option<NoiseSeed>) -> Self {
        Self { q0, noise: noise.map(Noise::new) }
    }

    /// The next observation.
    pub fn observe(&mut self, row: &Row) -> Proprioception {
        let world_from_pelvis = &row.robot.pose.rotation;
        let in_pelvis = |vector: &Vector3<f64>| world_from_pelvis.inverse_transform_vector(vector).into();
        let mut sensed = Proprioception {
            base_angular_velocity: in_pelvis(&row.robot.angular_velocity),
            projected_gravity: in_pelvis(&-Vector3::z()),
            base_linear_velocity: in_pelvis(&row.robot.linear_velocity),
            base_height: row.robot.pose.translation.z,
            joint_position: std::array::from_fn(|joint| row.joint_position[joint] - self.q0[joint]),
            joint_velocity: row.joint_velocity,
        };
        if let Some(noise) = &mut self.noise {
            noise.add_to(&mut sensed);
        }
        sensed
    }
}

/// The streams of all terms.
#[derive(Debug, Clone)]
struct Noise {
    angular_velocity: Random,
    gravity: Random,
    linear_velocity: Random,
    height: Random,
    joint_position: Random,
    joint_velocity: Random,
}

impl Noise {
    fn new(NoiseSeed { seed, episode }: NoiseSeed) -> Self {
        let of = |term| Random::of_term(Stream::Noise, term, seed, episode);
        Self {
            angular_velocity: of("base_angular_velocity"),
            gravity: of("projected_gravity"),
            linear_velocity: of("base_linear_velocity"),
            height: of("base_height"),
            joint_position: of("joint_position"),
            joint_velocity: of("joint_velocity"),
        }
    }

    fn add_to(&mut self, sensed: &mut Proprioception) {
        let add = |random: &mut Random, half_width: f64, values: &mut [f64]| {
            for value in values {
                *value += random.uniform(-half_width, half_width);
            }
        };
        add(&mut self.angular_velocity, ANGULAR_VELOCITY_NOISE, &mut sensed.base_angular_velocity);
        add(&mut self.gravity, GRAVITY_NOISE, &mut sensed.projected_gravity);
        add(&mut self.linear_velocity, LINEAR_VELOCITY_NOISE, &mut sensed.base_linear_velocity);
        add(&mut self.height, HEIGHT_NOISE, std::slice::from_mut(&mut sensed.base_height));
        add(&mut self.joint_position, JOINT_POSITION_NOISE, &mut sensed.joint_position);
        add(&mut self.joint_velocity, JOINT_VELOCITY_NOISE, &mut sensed.joint_velocity);
    }
}

#[cfg(test)]
mod tests;
