use fiatlux_rules::Bulb;

use super::within;
use crate::{Random, SceneError, Stream};

/// Sizes of the props, as factors of the config's. The default is 1 throughout. Masses do not change.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PropScale {
    /// Ladder along its x, y and z.
    pub ladder: [f64; 3],
    /// Socket, along all axes.
    pub socket: f64,
    /// Fresh bulb, along all axes. The old bulb keeps its size.
    pub fresh_bulb: f64,
}

impl Default for PropScale {
    fn default() -> Self {
        Self { ladder: [1.0; 3], socket: 1.0, fresh_bulb: 1.0 }
    }
}

impl PropScale {
    /// Limits of the ladder's factors (published benchmark, events).
    pub const LADDER: [[f64; 2]; 3] = [[0.95, 1.05], [0.95, 1.05], [0.95, 1.10]];
    /// Limits of the socket's factor (published benchmark, events).
    pub const SOCKET: [f64; 2] = [0.9, 1.1];
    /// Limits of the fresh bulb's factor (published benchmark, events).
    pub const FRESH_BULB: [f64; 2] = [0.9, 1.1];

    /// The sizes of a seed.
    pub fn draw(seed: u64) -> Self {
        let random = &mut Random::new(Stream::Props, seed, 0);
        Self {
            ladder: Self::LADDER.map(|limits| within(random, limits)),
            socket: within(random, Self::SOCKET),
            fresh_bulb: within(random, Self::FRESH_BULB),
        }
    }

    /// Factor of a bulb.
    pub fn bulb(&self, bulb: Bulb) -> f64 {
        match bulb {
            Bulb::Old => 1.0,
            Bulb::Fresh => self.fresh_bulb,
        }
    }

    /// Each factor with its name and limits.
    pub fn factors(&self) -> [(&'static str, f64, [f64; 2]); 5] {
        let [x, y, z] = self.ladder;
        let [limits_x, limits_y, limits_z] = Self::LADDER;
        [
            ("ladder_x", x, limits_x),
            ("ladder_y", y, limits_y),
            ("ladder_z", z, limits_z),
            ("socket", self.socket, Self::SOCKET),
            ("fresh_bulb", self.fresh_bulb, Self::FRESH_BULB),
        ]
    }

    /// Checks that every factor is within its limits.
    ///
    /// # Errors
    /// [`SceneError::Scale`] for the first factor that is not.
    pub fn check(&self) -> Result<(), SceneError> {
        match self.factors().into_iter().find(|(_, value, [low, high])| !(*low..=*high).contains(value)) {
            Some((factor, value, [low, high])) => Err(SceneError::Scale { factor, value, low, high }),
            None => Ok(()),
        }
    }
}
