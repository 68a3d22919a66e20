//! Random draws for an episode, besides its task.
//!
//! | moment | what | drawn from |
//! |---|---|---|
//! | the room is laid out | [`Layout`](crate::Layout) | layout seed |
//! | before start-up, where asked for | [`PropScale`] | seed |
//! | start-up | [`HandFriction`] | seed (64 materials), seed and episode (which of them) |
//! | reset, where asked for | [`EpisodeRanges`] | seed and episode |
//! | reset | [`StartOffset`](crate::StartOffset), [`Light`] and tint, noise of the sensors | seed and episode |
//!
//! Each is drawn from its own stream, so that omitting one does not change the others.

mod camera;
mod hand_friction;
mod light;
mod prop_scale;
mod ranges;

pub use camera::{CameraVariation, camera_ranges};
pub use hand_friction::HandFriction;
pub use light::Light;
pub use prop_scale::PropScale;
pub use ranges::{EpisodeRanges, RangeError, Varied, delay_steps, free_things, noise_scale, surfaces};
pub(crate) use ranges::{check_varied, vary, vary_gains};

use crate::Random;

/// Which quantities an episode draws. The others are nominal. The default is the benchmark's.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Randomization {
    /// The room, from the seed; else it is that of layout seed 0.
    pub layout: bool,
    /// Place, heading and joints of the robot at the start.
    pub start: bool,
    /// Friction of the hands; else it is the robot file's own.
    pub hand_friction: bool,
    /// Light of the sky and of the lamp.
    pub light: bool,
    /// Tint of the room.
    pub tint: bool,
    /// Noise of the sensors.
    pub sensors: bool,
    /// Sizes of ladder, socket and fresh bulb.
    pub prop_scale: bool,
}

impl Randomization {
    /// Draws nothing: all episodes of a task are the same.
    pub const FIXED: Self = Self {
        layout: false,
        start: false,
        hand_friction: false,
        light: false,
        tint: false,
        sensors: false,
        prop_scale: false,
    };
}

impl Default for Randomization {
    fn default() -> Self {
        Self {
            layout: true,
            start: true,
            hand_friction: true,
            light: true,
            tint: true,
            sensors: true,
            prop_scale: false,
        }
    }
}

/// Uniform within a range.
fn within(random: &mut Random, [low, high]: [f64; 2]) -> f64 {
    random.uniform(low, high)
}

#[cfg(test)]
mod tests;
