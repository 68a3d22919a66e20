use std::f64::consts::TAU;

use super::{Randomization, within};
use crate::{Random, Stream};

/// Light of the scene and tint of the room. The default is nominal.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Light {
    /// Intensity of the dome, in the published scene's units.
    pub dome: f64,
    /// Turn of the dome about the vertical, rad.
    pub dome_yaw: f64,
    /// Intensity of the key light, in the published scene's units.
    pub key: f64,
    /// Turn of the key light off its nominal direction: first this, about the world's x, rad.
    pub key_pitch: f64,
    /// Then this, about the vertical, rad.
    pub key_yaw: f64,
    /// Hue of the tint, degrees.
    pub tint_hue: f64,
    /// Saturation of the tint; 0 is grey.
    pub tint_saturation: f64,
    /// Value of the tint. The tint multiplies the room's colours.
    pub tint_value: f64,
}

/// Ranges, from the published benchmark's events.
impl Light {
    /// Intensity of the dome.
    pub const DOME: [f64; 2] = [600.0, 1400.0];
    /// Turn of the dome, rad.
    pub const DOME_YAW: [f64; 2] = [0.0, TAU];
    /// Intensity of the key light.
    pub const KEY: [f64; 2] = [800.0, 2200.0];
    /// Pitch of the key light, rad.
    pub const KEY_PITCH: [f64; 2] = [-15.0_f64.to_radians(), 15.0_f64.to_radians()];
    /// Yaw of the key light, rad.
    pub const KEY_YAW: [f64; 2] = [-30.0_f64.to_radians(), 30.0_f64.to_radians()];
    /// Hue of the tint, degrees.
    pub const TINT_HUE: [f64; 2] = [0.0, 360.0];
    /// Saturation of the tint; 0 is grey.
    pub const TINT_SATURATION: [f64; 2] = [0.0, 0.15];
    /// Value of the tint, a factor of brightness.
    pub const TINT_VALUE: [f64; 2] = [0.7, 1.2];
}

impl Default for Light {
    fn default() -> Self {
        Self {
            dome: 1000.0,
            dome_yaw: 0.0,
            key: 1500.0,
            key_pitch: 0.0,
            key_yaw: 0.0,
            tint_hue: 0.0,
            tint_saturation: 0.0,
            tint_value: 1.0,
        }
    }
}

impl Light {
    /// The light of an episode; what is not to be drawn is nominal.
    pub fn draw(seed: u64, episode: u64, randomize: &Randomization) -> Self {
        let mut light = Self::default();
        if randomize.light {
            let random = &mut Random::new(Stream::Light, seed, episode);
            light.dome = within(random, Self::DOME);
            light.dome_yaw = within(random, Self::DOME_YAW);
            light.key = within(random, Self::KEY);
            light.key_pitch = within(random, Self::KEY_PITCH);
            light.key_yaw = within(random, Self::KEY_YAW);
        }
        if randomize.tint {
            let random = &mut Random::new(Stream::Tint, seed, episode);
            light.tint_hue = within(random, Self::TINT_HUE);
            light.tint_saturation = within(random, Self::TINT_SATURATION);
            light.tint_value = within(random, Self::TINT_VALUE);
        }
        light
    }
}
