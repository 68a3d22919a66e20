//! The rhythm of the feet.

use serde::{Deserialize, Serialize};

use crate::CONTROL_DT;

/// Steps of one foot a second.
const RATE: f64 = 1.3;
/// Part of its period in which a foot swings.
const SWING: f64 = 0.45;
/// Height of a swinging sole, m.
const SWING_HEIGHT: f64 = 0.08;

/// When each foot is due up and down. On a command to stand it stops as soon as both are due down.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Clock {
    /// Of the left foot, from 0 to 1; the right foot is half a period later.
    phase: f64,
    stands: bool,
}

impl Default for Clock {
    /// Standing, before the left foot's step.
    fn default() -> Self {
        Self { phase: 0.98, stands: true }
    }
}

impl Clock {
    /// Walking, at a phase from 0 to 1.
    pub fn at(phase: f64) -> Self {
        Self { phase, stands: false }
    }

    /// Goes on by a control step.
    pub fn advance(&mut self, walks: bool) {
        self.stands = !walks && (0..2).all(|foot| self.phase(foot) >= SWING);
        if !self.stands {
            self.phase = (self.phase + RATE * CONTROL_DT) % 1.0;
        }
    }

    fn phase(&self, foot: usize) -> f64 {
        (self.phase + 0.5 * foot as f64) % 1.0
    }

    /// True if both feet are due down until a command to walk.
    pub fn stands(&self) -> bool {
        self.stands
    }

    /// True if a foot is due on the floor: 0 is the left one.
    pub fn is_down(&self, foot: usize) -> bool {
        self.stands || self.phase(foot) >= SWING
    }

    /// Height that a sole is due at, m.
    pub fn height(&self, foot: usize) -> f64 {
        if self.is_down(foot) {
            return 0.0;
        }
        let lift = libm::sin(std::f64::consts::PI * self.phase(foot) / SWING);
        SWING_HEIGHT * lift * lift
    }

    /// Where the left foot is due in its stride: 1 at the back, where it lifts, to -1 at the front; the right foot's is the
    /// negative. It stays as it is while the clock stands.
    pub fn stride(&self) -> f64 {
        libm::cos(std::f64::consts::TAU * self.phase)
    }

    /// As the controller observes it: cosine and sine of each foot's phase; zeros while it stands.
    pub fn signal(&self) -> [f64; 4] {
        if self.stands {
            return [0.0; 4];
        }
        let [left, right] = [0, 1].map(|foot| std::f64::consts::TAU * self.phase(foot));
        [libm::cos(left), libm::sin(left), libm::cos(right), libm::sin(right)]
    }
}
