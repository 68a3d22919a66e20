//! The trait of inputs, and what they have in common.

use thiserror::Error;

use crate::frame::{Frame, Order};

/// Turns the messages of a device into frames and orders. A message names its input; a page may send those of several.
pub trait Input: Send {
    /// The name in the messages.
    fn name(&self) -> &'static str;

    /// Reads a message. An order is given once for each press of its button.
    ///
    /// # Errors
    /// [`InputError`]: the message is not one of the device; nothing is taken from it then.
    fn read(&mut self, message: &serde_json::Value) -> Result<Reading, InputError>;
}

/// Content of a message.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Reading {
    /// `None` where the device is lost, or its user is not looking: the robot stands.
    pub frame: Option<Frame>,
    pub orders: Vec<Order>,
}

/// Why a message of an input is refused.
#[derive(Debug, Error)]
pub enum InputError {
    #[error("no input is named '{name}'; known ones are {known}")]
    Unknown { name: String, known: String },
    #[error("cannot read a message of the {input}; reload the page")]
    Message { input: &'static str, source: serde_json::Error },
    #[error("{field} of the {input} is {value}; it must be a number of size {most} at most")]
    Number { input: &'static str, field: &'static str, value: f64, most: f64 },
    #[error("the {input} sends {count} numbers for a hand's joints; there must be {expected}")]
    Count { input: &'static str, count: usize, expected: usize },
    #[error("the {input} sends joints of version {version}; this program reads version {known}: reload the page")]
    Version { input: &'static str, version: u64, known: u64 },
}

/// Sticks closer to their centre than this count as released: those of headsets drift.
const DEADZONE: f64 = 0.15;

/// A stick's axis as a share from -1 to 1, beyond the dead zone.
pub(crate) fn stick(value: f64) -> f64 {
    let beyond = (value.abs() - DEADZONE).max(0.0) / (1.0 - DEADZONE);
    beyond.min(1.0).copysign(value)
}

/// Refuses numbers that no device gives.
pub(crate) fn check(input: &'static str, field: &'static str, values: &[f64], most: f64) -> Result<(), InputError> {
    match values.iter().find(|value| value.is_nan() || value.abs() > most) {
        Some(&value) => Err(InputError::Number { input, field, value, most }),
        None => Ok(()),
    }
}

/// Notices when buttons go down.
#[derive(Debug, Default)]
pub(crate) struct Presses(Vec<bool>);

impl Presses {
    /// Takes the state of all buttons; returns those that went down since the last call. What is held at the first one counts
    /// as held before.
    pub fn down(&mut self, now: impl IntoIterator<Item = bool>) -> Vec<bool> {
        let now: Vec<bool> = now.into_iter().collect();
        let down = now.iter().enumerate().map(|(index, down)| *down && self.0.get(index) == Some(&false)).collect();
        self.0 = now;
        down
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stick_at_rest_is_zero_and_at_its_stop_one() {
        assert_eq!([0.0, 0.14, -0.15, 1.0, -1.0, 1.4].map(stick), [0.0, 0.0, -0.0, 1.0, -1.0, 1.0]);
        assert!((stick(0.575) - 0.5).abs() < 1e-12);
    }

    #[test]
    fn a_button_counts_once() {
        let mut presses = Presses::default();
        assert_eq!(presses.down([true, false]), [false, false], "held before");
        assert_eq!(presses.down([false, true]), [false, true]);
        assert_eq!(presses.down([true, true]), [true, false]);
        assert_eq!(presses.down([true, true]), [false, false]);
    }
}
