//! What the robot senses of its own body: a row, and uniform noise.

use fiatlux_proto::Proprioception;
use fiatlux_rules::Row;
use fiatlux_world::{EpisodeSpec, Random, Stream};
use nalgebra::Vector3;

/// Which episode's noise is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct NoiseSeed {
    /// Seed of the session.
    pub seed: u64,
    /// Index of the episode.
    pub episode: u64,
}

impl NoiseSeed {
    /// Of an episode; none where its sensors have no noise.
    pub fn of(spec: &EpisodeSpec) -> Option<Self> {
        spec.randomize.sensors.then_some(Self { seed: spec.seed, episode: spec.episode })
    }
}

/// Turns the rows of one episode into what its robot senses.
///
/// Each term has its own random stream, of which every row takes the same count: the noise of row k is the same whatever
/// the rows hold, and whichever of them are observed.
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

    /// Begins another episode of the same robot.
    pub fn restart(&mut self, noise: Option<NoiseSeed>) {
        self.noise = noise.map(Noise::new);
    }

    /// Writes what the robot senses in a row.
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
            noise.add_to(sensed, row.step);
        }
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

#[derive(Debug, Clone)]
struct Noise {
    seed: NoiseSeed,
    streams: [Random; 6],
    /// Row whose noise comes next.
    next: u64,
}

impl Noise {
    fn new(seed: NoiseSeed) -> Self {
        let stream = |(name, _)| Random::of_term(Stream::Noise, name, seed.seed, seed.episode);
        Self { seed, streams: NOISE.map(stream), next: 0 }
    }

    fn add_to(&mut self, sensed: &mut Proprioception, step: u64) {
        if step < self.next {
            *self = Self::new(self.seed);
        }
        let left_out = step - self.next;
        self.next = step + 1;
        let terms: [&mut [f64]; 6] = [
            &mut sensed.base_angular_velocity,
            &mut sensed.projected_gravity,
            &mut sensed.base_linear_velocity,
            std::slice::from_mut(&mut sensed.base_height),
            &mut sensed.joint_position,
            &mut sensed.joint_velocity,
        ];
        for ((random, (_, half_width)), values) in self.streams.iter_mut().zip(NOISE).zip(terms) {
            if left_out > 0 {
                random.skip(left_out.saturating_mul(values.len() as u64));
            }
            values.iter_mut().for_each(|value| *value += random.uniform(-half_width, half_width));
        }
    }
}

#[cfg(test)]
mod tests;
