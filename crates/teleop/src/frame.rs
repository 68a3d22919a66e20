//! An operator's command, whatever the input is.

use nalgebra::Isometry3;

/// An operator's command at a moment. All shares are from -1 to 1.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Frame {
    /// Shares of the largest velocity: forwards, to the left, and turning to the left.
    pub walk: [f64; 3],
    /// Share of the rate at which the pelvis rises.
    pub rise: f64,
    /// Shares of the rates at which the torso pitches forwards and turns to the left.
    pub torso: [f64; 2],
    /// The left hand and the right one.
    pub hands: [Hand; 2],
    /// Counts how often the origin of the devices' space has moved. Poses before and after a change are not comparable.
    pub space: u64,
}

/// Command to a hand.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Hand {
    pub motion: Motion,
    /// Closure of the fingers, from 0 to 1; `None` leaves them as they are.
    pub close: Option<f64>,
}

/// Motion of a hand.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Motion {
    /// It stays where it is on the robot.
    #[default]
    Still,
    /// Shares of the largest rates along and about the axes of the pelvis: forwards, left, up.
    Rate { linear: [f64; 3], angular: [f64; 3] },
    /// It repeats the motion of a device while the operator holds it: x forwards, y left, z up, m.
    Follow(Isometry3<f64>),
}

/// An operator's order for the take.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, serde::Deserialize, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Order {
    /// Starts the clock of the room that is shown.
    Start,
    /// Ends the take. It is kept unless it is discarded.
    Stop,
    /// Keeps the take, and shows the same room again.
    Save,
    /// Puts the take aside, and shows the same room again.
    Discard,
    /// Keeps the take, and shows the next room.
    Next,
}

impl Frame {
    /// True if nothing is asked for.
    pub fn is_idle(&self) -> bool {
        let still = |hand: &Hand| matches!(hand.motion, Motion::Still);
        self.walk == [0.0; 3] && self.rise == 0.0 && self.torso == [0.0; 2] && self.hands.iter().all(still)
    }
}
