//! Keys of the page: walking, and the chosen hand.

use serde::Deserialize;
use serde_json::Value;

use crate::frame::{Fingers, Frame, Hand, Motion, Order};
use crate::input::{Input, InputError, Presses, Reading};

/// Codes of the keys by what they do, as `KeyboardEvent.code` has them. A pair is for less and for more.
const WALK: [[&str; 2]; 3] = [["KeyS", "KeyW"], ["KeyD", "KeyA"], ["KeyE", "KeyQ"]];
const RISE: [&str; 2] = ["KeyF", "KeyR"];
const TORSO: [[&str; 2]; 2] = [["KeyT", "KeyG"], ["KeyH", "KeyY"]];
const LINEAR: [[&str; 2]; 3] = [["KeyK", "KeyI"], ["KeyL", "KeyJ"], ["KeyU", "KeyO"]];
const ANGULAR: [[&str; 2]; 3] = [["Comma", "Period"], ["ArrowUp", "ArrowDown"], ["ArrowRight", "ArrowLeft"]];
/// Keys that count when they go down: the left hand, the right hand, grip, and the orders.
const PRESSED: [&str; 7] = ["Digit1", "Digit2", "Space", "Enter", "KeyP", "Delete", "KeyN"];
/// Most keys of a message.
const MAX_KEYS: usize = 32;

/// The keyboard.
#[derive(Debug)]
pub struct Keyboard {
    presses: Presses,
    /// The chosen hand: 0 is left.
    hand: usize,
    /// Hands that were told to close or to open.
    closed: [Option<bool>; 2],
    is_running: bool,
}

impl Default for Keyboard {
    fn default() -> Self {
        Self { presses: Presses::default(), hand: 1, closed: [None; 2], is_running: false }
    }
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Message {
    keys: Vec<String>,
    /// The page has the focus: keys that go up elsewhere are not noticed.
    focused: bool,
    /// A take runs, so that one key can start and stop it.
    running: bool,
}

impl Input for Keyboard {
    fn name(&self) -> &'static str {
        "keyboard"
    }

    fn read(&mut self, message: &Value) -> Result<Reading, InputError> {
        let message = Message::deserialize(message);
        let Message { keys, focused, running } =
            message.map_err(|source| InputError::Message { input: self.name(), source })?;
        let is_down = |key: &str| focused && keys.iter().take(MAX_KEYS).any(|down| down == key);
        let share = |[less, more]: [&str; 2]| f64::from(i8::from(is_down(more)) - i8::from(is_down(less)));
        let down = self.presses.down(PRESSED.map(is_down));
        self.is_running = running;
        for (hand, down) in down[..2].iter().enumerate() {
            self.hand = if *down { hand } else { self.hand };
        }
        if down[2] {
            let closed = &mut self.closed[self.hand];
            *closed = Some(!closed.unwrap_or(false));
        }
        let start = if running { Order::Stop } else { Order::Start };
        let orders = [start, Order::Save, Order::Discard, Order::Next].into_iter().zip(&down[3..]);
        let orders = orders.filter(|(_, down)| **down).map(|(order, _)| order).collect();
        if !focused {
            return Ok(Reading { frame: None, orders });
        }
        let mut hands = self
            .closed
            .map(|closed| Hand { fingers: closed.map(|closed| Fingers::Close(f64::from(closed))), ..Hand::default() });
        let (linear, angular) = (LINEAR.map(share), ANGULAR.map(share));
        if linear.iter().chain(&angular).any(|share| *share != 0.0) {
            hands[self.hand].motion = Motion::Rate { linear, angular };
        }
        let (walk, torso, chosen) = (WALK.map(share), TORSO.map(share), Some(self.hand));
        let frame = Frame { walk, rise: share(RISE), torso, hands, chosen, space: 0 };
        Ok(Reading { frame: Some(frame), orders })
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn read(keyboard: &mut Keyboard, keys: &[&str]) -> Reading {
        keyboard.read(&json!({ "keys": keys, "focused": true, "running": false })).expect("a message")
    }

    #[test]
    fn keys_walk_and_opposite_ones_cancel() {
        let mut keyboard = Keyboard::default();
        let frame = read(&mut keyboard, &["KeyW", "KeyA", "KeyD", "KeyE"]).frame.expect("focused");
        assert_eq!(frame.walk, [1.0, 0.0, -1.0]);
    }

    #[test]
    fn the_chosen_hand_moves_and_closes() {
        let mut keyboard = Keyboard::default();
        read(&mut keyboard, &[]);
        let frame = read(&mut keyboard, &["Digit1", "KeyI", "Space"]).frame.expect("focused");
        assert_eq!(frame.hands[0].motion, Motion::Rate { linear: [1.0, 0.0, 0.0], angular: [0.0; 3] });
        assert_eq!((frame.hands[0].fingers, frame.hands[1].fingers), (Some(Fingers::Close(1.0)), None));
        read(&mut keyboard, &[]);
        assert_eq!(read(&mut keyboard, &["Space"]).frame.expect("focused").hands[0].fingers, Some(Fingers::Close(0.0)));
    }

    #[test]
    fn a_page_without_the_focus_stands_and_orders_count_once() {
        let mut keyboard = Keyboard::default();
        read(&mut keyboard, &[]);
        assert_eq!(read(&mut keyboard, &["Enter"]).orders, [Order::Start]);
        assert_eq!(read(&mut keyboard, &["Enter"]).orders, []);
        let away = json!({ "keys": ["KeyW"], "focused": false, "running": true });
        assert_eq!(keyboard.read(&away).expect("a message").frame, None);
        assert!(keyboard.read(&json!({ "keys": [1] })).is_err());
    }
}
