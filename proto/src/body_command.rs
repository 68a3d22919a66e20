//! The command to a whole-body controller, which messages, sessions, controllers and policies share.

use serde::{Deserialize, Serialize};

use crate::v3::WholeBodyCommand;

/// Height of the pelvis that a robot walks at by default, m.
pub const NOMINAL_HEIGHT: f64 = 0.75;
/// Velocities below these ask to stand: m/s, m/s, rad/s.
const STANDS_BELOW: [f64; 3] = [0.05, 0.05, 0.05];

/// A command to legs and waist: velocity, height, and how the torso leans.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct BodyCommand {
    /// Of the pelvis, forwards and left, m/s, and about the vertical, rad/s.
    pub velocity: [f64; 3],
    /// Of the pelvis above the floor, m.
    pub height: f64,
    /// Roll, pitch and yaw of the torso, rad, from axes that stand upright and point where the pelvis points.
    pub torso: [f64; 3],
}

impl Default for BodyCommand {
    /// Standing upright at the nominal height.
    fn default() -> Self {
        Self { velocity: [0.0; 3], height: NOMINAL_HEIGHT, torso: [0.0; 3] }
    }
}

macro_rules! names {
    ($first:literal $(, $rest:literal)*) => {
        /// Names of its [numbers](BodyCommand::numbers).
        pub const NAMES: [&str; 7] = [$first $(, $rest)*];
        /// The names in one line.
        pub const NAME_LIST: &str = concat!($first $(, ", ", $rest)*);
        /// The numbers as fields of an action.
        pub const FIELDS: [&str; 7] = [concat!("whole_body.", $first) $(, concat!("whole_body.", $rest))*];
    };
}

impl BodyCommand {
    /// Speeds ahead, to the left (m/s) and about the vertical (rad/s) below which it asks to stand.
    pub const STANDS_BELOW: [f64; 3] = STANDS_BELOW;

    names!("vx", "vy", "wz", "height", "roll", "pitch", "yaw");

    /// Its parts in the chunk of an action, as KEY:NUMBERS, in the order of its numbers.
    pub const CHUNK_KEYS: [&str; 3] = ["navigate:3", "height:1", "torso:3"];

    /// As the controller observes it, and in the order of `SessionInfo.whole_body_range`.
    pub fn numbers(&self) -> [f64; 7] {
        let ([vx, vy, wz], [roll, pitch, yaw]) = (self.velocity, self.torso);
        [vx, vy, wz, self.height, roll, pitch, yaw]
    }

    /// True if it asks for steps.
    pub fn walks(&self) -> bool {
        self.velocity.iter().zip(STANDS_BELOW).any(|(velocity, least)| velocity.abs() >= least)
    }

    /// Index and value of its first number outside of these ranges, each from low to high; NaN is outside of any.
    pub fn outside(&self, ranges: &[[f64; 2]; 7]) -> Option<(usize, f64)> {
        let is_outside = |(value, [low, high]): (&f64, &[f64; 2])| !(low..=high).contains(&value);
        let numbers = self.numbers();
        let index = numbers.iter().zip(ranges).position(is_outside)?;
        Some((index, numbers[index]))
    }
}

impl From<[f64; 7]> for BodyCommand {
    fn from([vx, vy, wz, height, roll, pitch, yaw]: [f64; 7]) -> Self {
        Self { velocity: [vx, vy, wz], height, torso: [roll, pitch, yaw] }
    }
}

impl From<WholeBodyCommand> for BodyCommand {
    fn from(message: WholeBodyCommand) -> Self {
        let WholeBodyCommand { vx, vy, wz, height, roll, pitch, yaw } = message;
        [vx, vy, wz, height, roll, pitch, yaw].into()
    }
}

impl From<BodyCommand> for WholeBodyCommand {
    fn from(command: BodyCommand) -> Self {
        let [vx, vy, wz, height, roll, pitch, yaw] = command.numbers();
        Self { vx, vy, wz, height, roll, pitch, yaw }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Names, numbers, fields of the message and parts of a chunk have one order.
    #[test]
    fn a_command_is_the_same_in_every_form() {
        let numbers = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0];
        let message = WholeBodyCommand { vx: 1.0, vy: 2.0, wz: 3.0, height: 4.0, roll: 5.0, pitch: 6.0, yaw: 7.0 };
        let command = BodyCommand::from(message);
        assert_eq!((command, WholeBodyCommand::from(command)), (BodyCommand::from(numbers), message));
        assert_eq!(command.numbers(), numbers);
        assert_eq!((command.velocity, command.height, command.torso), ([1.0, 2.0, 3.0], 4.0, [5.0, 6.0, 7.0]));
        let text = format!("{message:?}");
        let places = BodyCommand::NAMES.map(|name| text.find(&format!("{name}: ")).expect("a field of the message"));
        assert!(places.is_sorted(), "{text}");
        assert_eq!(BodyCommand::NAMES.join(", "), BodyCommand::NAME_LIST);
        assert_eq!(BodyCommand::NAMES.map(|name| format!("whole_body.{name}")), BodyCommand::FIELDS);
    }

    #[test]
    fn a_number_out_of_its_range_is_found() {
        let ranges = [[-1.0, 1.0]; 7];
        assert_eq!(BodyCommand::default().outside(&ranges), None);
        for index in 0..7 {
            for wrong in [1.1, -1.1, f64::NAN, f64::INFINITY] {
                let mut numbers = [1.0; 7];
                numbers[index] = wrong;
                let (found, value) = BodyCommand::from(numbers).outside(&ranges).expect("out of range");
                assert!(found == index && value.to_bits() == wrong.to_bits());
            }
        }
    }
}
