//! A gamepad in the browser, in the mapping that the W3C calls standard.

use serde::Deserialize;
use serde_json::Value;

use crate::frame::{Fingers, Frame, Hand, Motion, Order};
use crate::input::{Input, InputError, Presses, Reading, check, stick};

/// Buttons by their index: bumpers, triggers, the cross, and those that are orders: A, X, B, Y.
const BUMPERS: [usize; 2] = [4, 5];
const TRIGGERS: [usize; 2] = [6, 7];
const CROSS: [usize; 4] = [12, 13, 14, 15];
const ORDERS: [usize; 4] = [0, 2, 1, 3];
/// A trigger counts once it was pulled this far: hands that hold something at the start keep it until then.
const PULLED: f64 = 0.05;
/// Most axes and buttons of a pad.
const MAX_PARTS: usize = 64;

/// The gamepad.
#[derive(Debug, Default)]
pub struct Gamepad {
    presses: Presses,
    was_pulled: [bool; 2],
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Message {
    /// Two for each stick, x to the right and y downwards.
    axes: Vec<f64>,
    /// Values from 0 to 1.
    buttons: Vec<f64>,
    connected: bool,
    running: bool,
}

impl Input for Gamepad {
    fn name(&self) -> &'static str {
        "gamepad"
    }

    fn read(&mut self, message: &Value) -> Result<Reading, InputError> {
        let name = self.name();
        let message = Message::deserialize(message);
        let Message { axes, buttons, connected, running } =
            message.map_err(|source| InputError::Message { input: name, source })?;
        check(name, "an axis", &axes[..axes.len().min(MAX_PARTS)], 2.0)?;
        check(name, "a button", &buttons[..buttons.len().min(MAX_PARTS)], 2.0)?;
        let button = |index: usize| buttons.get(index).copied().unwrap_or_default();
        let axis = |index: usize| stick(axes.get(index).copied().unwrap_or_default());
        let start = if running { Order::Stop } else { Order::Start };
        let down = self.presses.down(ORDERS.map(|index| button(index) > 0.5));
        let orders = [start, Order::Save, Order::Discard, Order::Next].into_iter().zip(down);
        let orders = orders.filter(|(_, down)| *down).map(|(order, _)| order).collect();
        if !connected {
            return Ok(Reading { frame: None, orders });
        }
        let mut hands = <[Hand; 2]>::default();
        for (hand, (trigger, was_pulled)) in hands.iter_mut().zip(TRIGGERS.into_iter().zip(&mut self.was_pulled)) {
            *was_pulled |= button(trigger) > PULLED;
            hand.fingers = was_pulled.then(|| Fingers::Close(button(trigger).clamp(0.0, 1.0)));
        }
        let [up, down, left, right] = CROSS.map(button);
        let mut frame =
            Frame { torso: [up - down, left - right].map(|share| share.clamp(-1.0, 1.0)), ..Frame::default() };
        let held = BUMPERS.map(|bumper| button(bumper) > 0.5);
        // A held bumper lends the sticks to its hand.
        match held.iter().position(|held| *held) {
            Some(hand) => {
                let linear = [-axis(1), -axis(0), -axis(3)];
                hands[hand].motion = Motion::Rate { linear, angular: [0.0, 0.0, -axis(2)] };
            }
            None => {
                frame.walk = [-axis(1), -axis(0), -axis(2)];
                frame.rise = -axis(3);
            }
        }
        Ok(Reading { frame: Some(Frame { hands, ..frame }), orders })
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn read(pad: &mut Gamepad, axes: [f64; 4], pressed: &[(usize, f64)]) -> Reading {
        let mut buttons = [0.0; 17];
        pressed.iter().for_each(|(index, value)| buttons[*index] = *value);
        let message = json!({ "axes": axes, "buttons": buttons, "connected": true, "running": false });
        pad.read(&message).expect("a message")
    }

    #[test]
    fn forwards_is_up_and_a_bumper_lends_the_sticks() {
        let mut pad = Gamepad::default();
        let frame = read(&mut pad, [0.0, -1.0, 1.0, 0.0], &[]).frame.expect("connected");
        assert_eq!((frame.walk, frame.rise), ([1.0, 0.0, -1.0], 0.0));
        let frame = read(&mut pad, [0.0, -1.0, 0.0, -1.0], &[(5, 1.0)]).frame.expect("connected");
        assert_eq!(frame.walk, [0.0; 3]);
        assert_eq!(frame.hands[1].motion, Motion::Rate { linear: [1.0, 0.0, 1.0], angular: [0.0; 3] });
    }

    #[test]
    fn a_hand_stays_as_it_is_until_its_trigger_is_pulled() {
        let mut pad = Gamepad::default();
        assert_eq!(read(&mut pad, [0.0; 4], &[]).frame.expect("connected").hands[1].fingers, None);
        assert_eq!(
            read(&mut pad, [0.0; 4], &[(7, 0.5)]).frame.expect("connected").hands[1].fingers,
            Some(Fingers::Close(0.5))
        );
        assert_eq!(read(&mut pad, [0.0; 4], &[]).frame.expect("connected").hands[1].fingers, Some(Fingers::Close(0.0)));
    }

    #[test]
    fn a_pad_that_is_gone_stands_and_a_broken_one_is_refused() {
        let mut pad = Gamepad::default();
        let gone = json!({ "axes": [0, -1, 0, 0], "buttons": [], "connected": false, "running": false });
        assert_eq!(pad.read(&gone).expect("a message").frame, None);
        let broken = json!({ "axes": [0, 7.5], "buttons": [], "connected": true, "running": false });
        let error = pad.read(&broken).expect_err("too large").to_string();
        assert!(error.contains("an axis of the gamepad is 7.5"), "{error}");
        let nan = json!({ "axes": [null], "buttons": [], "connected": true, "running": false });
        assert!(pad.read(&nan).is_err());
    }
}
