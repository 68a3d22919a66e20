//! A headset: the poses of both controllers move the hands, their sticks the robot.

use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};
use serde::Deserialize;
use serde_json::Value;

use crate::frame::{Frame, Hand, Motion, Order};
use crate::input::{Input, InputError, Presses, Reading, check, stick};

/// Buttons and axes by their index in the mapping `xr-standard`.
const TRIGGER: usize = 0;
const SQUEEZE: usize = 1;
const LOWER: usize = 4;
const UPPER: usize = 5;
const STICK: [usize; 2] = [2, 3];
/// A squeeze beyond this holds the clutch.
const HELD: f64 = 0.5;
/// A trigger counts once it was pulled this far.
const PULLED: f64 = 0.05;
/// No device is farther from its origin, m, and no part of a quaternion or button larger.
const MAX_PLACE: f64 = 100.0;
const MAX_PART: f64 = 2.0;
const MAX_BUTTONS: usize = 16;
/// Shortest quaternion that has a direction.
const MIN_TURN: f64 = 0.1;

/// The headset.
#[derive(Debug, Default)]
pub struct WebXr {
    presses: Presses,
    was_pulled: [bool; 2],
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Message {
    /// Counts the resets of the reference space.
    space: u64,
    /// The session is visible: its user looks at it, and its inputs are not those of a menu.
    visible: bool,
    left: Option<Controller>,
    right: Option<Controller>,
    /// Heading of the view at the last re-centring about the vertical, rad: where forwards is.
    heading: f64,
    running: bool,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Controller {
    /// Of the grip: x, y, z, then the quaternion x, y, z, w; x right, y up, z backwards. None where it is not tracked.
    pose: Option<[f64; 7]>,
    buttons: Vec<f64>,
    axes: Vec<f64>,
}

impl Controller {
    fn check(&self) -> Result<(), InputError> {
        const NAME: &str = "headset";
        if let Some(pose) = &self.pose {
            check(NAME, "a controller's place", &pose[..3], MAX_PLACE)?;
            check(NAME, "a controller's turn", &pose[3..], MAX_PART)?;
        }
        check(NAME, "a button", &self.buttons[..self.buttons.len().min(MAX_BUTTONS)], MAX_PART)?;
        check(NAME, "an axis", &self.axes[..self.axes.len().min(MAX_BUTTONS)], MAX_PART)
    }

    fn button(&self, index: usize) -> f64 {
        self.buttons.get(index).copied().unwrap_or_default()
    }

    fn axis(&self, index: usize) -> f64 {
        stick(self.axes.get(index).copied().unwrap_or_default())
    }

    /// The pose of its grip with x forwards, y to the left, z up, from a user who looks along a heading.
    fn grip(&self, heading: f64) -> Option<Isometry3<f64>> {
        let [x, y, z, i, j, k, w] = self.pose?;
        let turn = Quaternion::new(w, -k, -i, j);
        if turn.norm() < MIN_TURN {
            return None;
        }
        let ahead = UnitQuaternion::from_axis_angle(&nalgebra::Vector3::z_axis(), -heading);
        let ahead = Isometry3::from_parts(Translation3::identity(), ahead);
        let grip = Isometry3::from_parts(Translation3::new(-z, -x, y), UnitQuaternion::from_quaternion(turn));
        // Into axes of the user, and turns about those: how the device is held at the start does not matter.
        Some(ahead * grip)
    }
}

impl Input for WebXr {
    fn name(&self) -> &'static str {
        "webxr"
    }

    fn read(&mut self, message: &Value) -> Result<Reading, InputError> {
        let name = "headset";
        let message = Message::deserialize(message);
        let Message { space, visible, left, right, heading, running } =
            message.map_err(|source| InputError::Message { input: name, source })?;
        check(name, "the heading", &[heading], 10.0)?;
        let sides = [left, right];
        sides.iter().flatten().try_for_each(Controller::check)?;
        let pressed = |side: usize, index: usize| sides[side].as_ref().is_some_and(|hand| hand.button(index) > 0.5);
        let start = if running { Order::Stop } else { Order::Start };
        let buttons = [(1, LOWER, start), (0, LOWER, Order::Save), (0, UPPER, Order::Discard), (1, UPPER, Order::Next)];
        let down = self.presses.down(buttons.map(|(side, index, _)| visible && pressed(side, index)));
        let orders = buttons.iter().zip(down).filter(|(_, down)| *down).map(|((.., order), _)| *order).collect();
        if !visible {
            return Ok(Reading { frame: None, orders });
        }
        let mut frame = Frame { space, ..Frame::default() };
        if let Some(left) = &sides[0] {
            (frame.walk[0], frame.walk[1]) = (-left.axis(STICK[1]), -left.axis(STICK[0]));
        }
        if let Some(right) = &sides[1] {
            (frame.walk[2], frame.rise) = (-right.axis(STICK[0]), -right.axis(STICK[1]));
        }
        for ((hand, side), was_pulled) in frame.hands.iter_mut().zip(&sides).zip(&mut self.was_pulled) {
            let Some(side) = side else { continue };
            *was_pulled |= side.button(TRIGGER) > PULLED;
            *hand = Hand { close: was_pulled.then(|| side.button(TRIGGER).clamp(0.0, 1.0)), motion: Motion::Still };
            if let (true, Some(grip)) = (side.button(SQUEEZE) > HELD, side.grip(heading)) {
                hand.motion = Motion::Follow(grip);
            }
        }
        Ok(Reading { frame: Some(frame), orders })
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;
    use serde_json::json;

    use super::*;

    fn controller(pose: Value, squeeze: f64, axes: [f64; 4]) -> Value {
        json!({ "pose": pose, "buttons": [0.0, squeeze, 0.0, 0.0, 0.0, 0.0], "axes": axes })
    }

    fn message(left: Value, right: Value, visible: bool) -> Value {
        json!({ "space": 3, "visible": visible, "left": left, "right": right, "heading": 0.0, "running": true })
    }

    #[test]
    fn the_devices_axes_become_the_robots() {
        let held = controller(json!([0.2, 1.1, -0.4, 0.0, 0.0, 0.0, 1.0]), 1.0, [0.0; 4]);
        let reading = WebXr::default().read(&message(Value::Null, held, true)).expect("a message");
        let frame = reading.frame.expect("visible");
        let Motion::Follow(pose) = frame.hands[1].motion else { panic!("{frame:?}") };
        assert!((pose.translation.vector - Vector3::new(0.4, -0.2, 1.1)).norm() < 1e-12);
        assert_eq!((frame.hands[0].motion, frame.space), (Motion::Still, 3));
    }

    /// A turn about the user's vertical (y there, z here) is one about the robot's.
    #[test]
    fn turns_keep_their_axes() {
        let turns: [([f64; 3], Vector3<f64>); 3] =
            [([1.0, 0.0, 0.0], -Vector3::y()), ([0.0, 1.0, 0.0], Vector3::z()), ([0.0, 0.0, 1.0], -Vector3::x())];
        for (axis, expected) in turns {
            let (sin, cos) = (0.3_f64.sin(), 0.3_f64.cos());
            let [i, j, k] = axis.map(|part: f64| part * sin);
            let held = controller(json!([0.0, 0.0, 0.0, i, j, k, cos]), 1.0, [0.0; 4]);
            let frame = WebXr::default().read(&message(held, Value::Null, true)).expect("a message").frame;
            let Motion::Follow(pose) = frame.expect("visible").hands[0].motion else { panic!("held") };
            assert!((pose.rotation.scaled_axis() - 0.6 * expected).norm() < 1e-9, "{axis:?}");
        }
    }

    #[test]
    fn sticks_walk_and_a_released_squeeze_lets_the_hand_go() {
        let left = controller(json!([0, 1, 0, 0, 0, 0, 1]), 0.2, [0.0, 0.0, -1.0, -1.0]);
        let right = controller(Value::Null, 1.0, [0.0, 0.0, 1.0, 0.0]);
        let frame = WebXr::default().read(&message(left, right, true)).expect("a message").frame.expect("visible");
        assert_eq!((frame.walk, frame.rise), ([1.0, 1.0, -1.0], 0.0));
        assert_eq!([frame.hands[0].motion, frame.hands[1].motion], [Motion::Still, Motion::Still]);
    }

    #[test]
    fn a_headset_that_is_taken_off_stands() {
        let left = controller(json!([0, 1, 0, 0, 0, 0, 1]), 1.0, [0.0, 0.0, -1.0, -1.0]);
        assert_eq!(WebXr::default().read(&message(left, Value::Null, false)).expect("a message").frame, None);
    }

    #[test]
    fn wrong_numbers_are_refused_by_name() {
        let far = controller(json!([1e9, 0, 0, 0, 0, 0, 1]), 1.0, [0.0; 4]);
        let error = WebXr::default().read(&message(far, Value::Null, true)).expect_err("far").to_string();
        assert!(error.contains("a controller's place of the headset"), "{error}");
        let turnless = controller(json!([0, 0, 0, 0, 0, 0, 0]), 1.0, [0.0; 4]);
        let frame = WebXr::default().read(&message(turnless, Value::Null, true)).expect("a message").frame;
        assert_eq!(frame.expect("visible").hands[0].motion, Motion::Still);
        let nan = controller(json!([null, 0, 0, 0, 0, 0, 1]), 1.0, [0.0; 4]);
        assert!(WebXr::default().read(&message(nan, Value::Null, true)).is_err());
    }
}
