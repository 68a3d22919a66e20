use super::within;
use crate::{Random, Stream};

/// Material of the hands' bodies: one of 64 that are drawn for a seed. Its restitution is 0.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HandFriction {
    /// The coefficient in force.
    pub dynamic_friction: f64,
    /// The static coefficient of the material, which is recorded and not used.
    pub static_friction: f64,
    /// Which of the seed's materials it is.
    pub bucket: u32,
}

impl HandFriction {
    /// Materials of a seed (published benchmark, events).
    pub const BUCKETS: u32 = 64;
    /// Range of the static coefficient (published benchmark, events).
    pub const STATIC: [f64; 2] = [0.8, 1.2];
    /// Range of the dynamic coefficient, which is never above the static one (published benchmark, events).
    pub const DYNAMIC: [f64; 2] = [0.7, 1.1];

    /// The material of an episode.
    pub fn draw(seed: u64, episode: u64) -> Self {
        let bucket =
            Random::of_term(Stream::HandFriction, "bucket", seed, episode).index(Self::BUCKETS as usize) as u32;
        Self::material(seed, bucket)
    }

    /// A material of a seed; `bucket` counts from 0 to 63.
    pub fn material(seed: u64, bucket: u32) -> Self {
        let mut random = Random::of_term(Stream::HandFriction, &format!("material {bucket}"), seed, 0);
        let static_friction = within(&mut random, Self::STATIC);
        let dynamic_friction = within(&mut random, Self::DYNAMIC).min(static_friction);
        Self { dynamic_friction, static_friction, bucket }
    }
}
