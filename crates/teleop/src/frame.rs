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
    /// The hand that keys move; `None` for inputs that move both.
    pub chosen: Option<usize>,
    /// Counts how often the origin of the devices' space has moved. Poses before and after a change are not comparable.
    pub space: u64,
}

/// Command to a hand.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Hand {
    pub motion: Motion,
    /// `None` leaves the fingers as they are.
    pub fingers: Option<Fingers>,
}

/// Command to the fingers of a hand.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Fingers {
    /// All of them, from 0, open, to 1, around a bulb.
    Close(f64),
    /// Those of a tracked hand. The robot's follow once the operator's are closed as far as they are.
    Bend(Bends),
}

/// Bends of a tracked hand, as shares from 0, straight, to 1, as in a fist.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Bends {
    /// The thumb, from beside the hand to across the palm.
    pub across: f64,
    /// The first joint of each finger: thumb, index, middle, ring, little finger.
    pub knuckles: [f64; 5],
    /// The joints beyond, together.
    pub middles: [f64; 5],
    /// The tip of the thumb and those of index and middle finger, from apart to touching.
    pub pinches: [f64; 2],
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
