//! A headset: the poses of both controllers move the hands, their sticks the robot. Hands that are tracked do both by gestures.

use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};
use serde::Deserialize;
use serde_json::Value;

use crate::frame::{Fingers, Frame, Hand, Motion, Order};
use crate::gestures::{Gestures, Seen};
use crate::input::{Input, InputError, Presses, Reading, check, stick};
use crate::tracked::{JOINTS, TrackedHand};

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
/// Version of the joints in a message, and how far one may be from the wrist, m.
const JOINTS_VERSION: u64 = 1;
const MAX_JOINT: f64 = 0.5;

/// The headset.
#[derive(Debug, Default)]
pub struct WebXr {
    presses: Presses,
    was_pulled: [bool; 2],
    gestures: Gestures,
    space: u64,
    /// Sides that were tracked hands, and how often a side has changed between a hand and a controller.
    were_hands: [bool; 2],
    switches: u64,
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
    /// Of the grip, or of a hand's wrist: x, y, z, then the quaternion x, y, z, w; x right, y up, z backwards. None where it is not
    /// tracked.
    pose: Option<[f64; 7]>,
    buttons: Vec<f64>,
    axes: Vec<f64>,
    /// A tracked hand takes the place of the controller.
    #[serde(default)]
    hand: Option<Joints>,
}

/// Joints of a tracked hand.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Joints {
    version: u64,
    /// x, y, z of each joint from the wrist in the order of the WebXR Hand Input, m.
    places: Vec<f64>,
}

impl Joints {
    fn check(&self, name: &'static str) -> Result<(), InputError> {
        if self.version != JOINTS_VERSION {
            return Err(InputError::Version { input: name, version: self.version, known: JOINTS_VERSION });
        }
        if self.places.len() != 3 * JOINTS {
            return Err(InputError::Count { input: name, count: self.places.len(), expected: 3 * JOINTS });
        }
        check(name, "a joint's place", &self.places, MAX_JOINT)
    }

    fn hand(&self, side: usize) -> Option<TrackedHand> {
        let mut joints = [Vector3::zeros(); JOINTS];
        joints.iter_mut().zip(self.places.as_chunks().0).for_each(|(joint, place)| *joint = Vector3::from(*place));
        TrackedHand::new(side, &joints)
    }
}

impl Controller {
    fn check(&self) -> Result<(), InputError> {
        const NAME: &str = "headset";
        if let Some(pose) = &self.pose {
            check(NAME, "a controller's place", &pose[..3], MAX_PLACE)?;
            check(NAME, "a controller's turn", &pose[3..], MAX_PART)?;
        }
        self.hand.as_ref().map_or(Ok(()), |hand| hand.check(NAME))?;
        check(NAME, "a button", &self.buttons[..self.buttons.len().min(MAX_BUTTONS)], MAX_PART)?;
        check(NAME, "an axis", &self.axes[..self.axes.len().min(MAX_BUTTONS)], MAX_PART)
    }

    /// A tracked hand has none, whatever its browser says.
    fn button(&self, index: usize) -> f64 {
        let buttons = if self.hand.is_some() { &[] } else { self.buttons.as_slice() };
        buttons.get(index).copied().unwrap_or_default()
    }

    fn axis(&self, index: usize) -> f64 {
        let axes = if self.hand.is_some() { &[] } else { self.axes.as_slice() };
        stick(axes.get(index).copied().unwrap_or_default())
    }

    /// The pose of its grip with x forwards, y to the left, z up, from a user who looks along a heading.
    fn grip(&self, heading: f64) -> Option<Isometry3<f64>> {
        let [x, y, z, i, j, k, w] = self.pose?;
        let turn = Quaternion::new(w, -k, -i, j);
        if turn.norm() < MIN_TURN {
            return None;
        }
        let ahead = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -heading);
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
        let has_moved = std::mem::replace(&mut self.space, space) != space;
        if !visible {
            self.gestures = Gestures::default();
            return Ok(Reading { frame: None, orders });
        }
        let hands = [0, 1].map(|side: usize| sides[side].as_ref().and_then(|of| of.hand.as_ref()?.hand(side)));
        // Wrist and grip are not in one place.
        let are_hands = [0, 1].map(|side: usize| match &sides[side] {
            Some(of) => of.hand.is_some(),
            None => self.were_hands[side],
        });
        self.switches += u64::from(std::mem::replace(&mut self.were_hands, are_hands) != are_hands);
        let mut frame = Frame { space: space.wrapping_add(self.switches), ..Frame::default() };
        if let Some(left) = &sides[0] {
            (frame.walk[0], frame.walk[1]) = (-left.axis(STICK[1]), -left.axis(STICK[0]));
        }
        if let Some(right) = &sides[1] {
            (frame.walk[2], frame.rise) = (-right.axis(STICK[0]), -right.axis(STICK[1]));
        }
        let grips = [0, 1].map(|side: usize| sides[side].as_ref().and_then(|of| of.grip(heading)));
        let seen = [0, 1].map(|side: usize| -> Option<Seen> { Some((grips[side]?.translation.vector, hands[side]?)) });
        for (side, doing) in self.gestures.step(&seen, has_moved).into_iter().enumerate() {
            if let (true, Some(wrist), Some(hand)) = (doing.is_followed, grips[side], hands[side]) {
                frame.hands[side] = Hand { motion: Motion::Follow(wrist), fingers: Some(Fingers::Bend(hand.bends)) };
            }
            match (side, doing.stick) {
                (0, Some([forwards, left, _])) => (frame.walk[0], frame.walk[1]) = (stick(forwards), stick(left)),
                (_, Some([_, left, up])) => (frame.walk[2], frame.rise) = (stick(left), stick(up)),
                (_, None) => {}
            }
        }
        for ((hand, side), was_pulled) in frame.hands.iter_mut().zip(&sides).zip(&mut self.was_pulled) {
            let Some(side) = side.as_ref().filter(|side| side.hand.is_none()) else { continue };
            *was_pulled |= side.button(TRIGGER) > PULLED;
            let close = was_pulled.then(|| Fingers::Close(side.button(TRIGGER).clamp(0.0, 1.0)));
            *hand = Hand { fingers: close, motion: Motion::Still };
            if let (true, Some(grip)) = (side.button(SQUEEZE) > HELD, side.grip(heading)) {
                hand.motion = Motion::Follow(grip);
            }
        }
        Ok(Reading { frame: Some(frame), orders })
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use crate::tracked::tests::{self, FIST, OPEN};

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

    /// A tracked hand whose wrist is at a place, x right, y up, z backwards.
    fn tracked(side: usize, at: [f64; 3], bent: [[f64; 2]; 5], pinch: Option<usize>) -> Value {
        let mut joints = tests::joints(side, 0.0, bent);
        if let Some(finger) = pinch {
            joints[4] = joints[5 * finger + 4] + Vector3::new(0.0, -0.01, 0.0);
        }
        let places: Vec<f64> = joints.iter().flat_map(|joint| [joint.x, joint.y, joint.z]).collect();
        let [x, y, z] = at;
        json!({ "pose": [x, y, z, 0, 0, 0, 1], "buttons": [1.0], "axes": [], "hand": { "version": 1, "places": places } })
    }

    fn frame(input: &mut WebXr, left: Value, right: Value) -> Frame {
        input.read(&message(left, right, true)).expect("a message").frame.expect("visible")
    }

    #[test]
    fn a_pinch_of_the_left_hand_lets_the_right_one_and_its_fingers_be_followed() {
        let mut input = WebXr::default();
        let fist = |side| tracked(side, [0.2, 1.1, -0.4], FIST, None);
        let at = frame(&mut input, tracked(0, [0.0, 1.0, -0.3], OPEN, None), fist(1));
        assert_eq!(at.hands, <[Hand; 2]>::default(), "no clutch, and a button of a hand is none");
        let at = frame(&mut input, tracked(0, [0.0, 1.0, -0.3], OPEN, Some(1)), fist(1));
        assert_eq!(at.hands[0], Hand::default());
        let Hand { motion: Motion::Follow(wrist), fingers: Some(Fingers::Bend(bends)) } = at.hands[1] else {
            panic!("{at:?}")
        };
        assert!((wrist.translation.vector - Vector3::new(0.4, -0.2, 1.1)).norm() < 1e-12);
        assert_eq!((bends.knuckles[1], bends.middles[4]), (1.0, 1.0));
    }

    #[test]
    fn middle_pinches_are_sticks() {
        let mut input = WebXr::default();
        let pinch = |side, at| tracked(side, at, OPEN, Some(2));
        let at = frame(&mut input, pinch(0, [-0.2, 1.0, -0.3]), pinch(1, [0.2, 1.0, -0.3]));
        assert!(at.is_idle(), "{at:?}");
        let at = frame(&mut input, pinch(0, [-0.2, 1.0, -0.45]), pinch(1, [0.1, 1.0, -0.3]));
        assert_eq!((at.walk[0], at.walk[1], at.rise), (1.0, 0.0, 0.0));
        assert!(at.walk[2] > 0.7 && at.walk[2] < 1.0, "to the left: {:?}", at.walk);
    }

    /// Wrist and grip of a hand are apart, and the robot's hand must not jump between them.
    #[test]
    fn a_hand_that_takes_up_a_controller_is_held_anew() {
        let mut input = WebXr::default();
        let held = || controller(json!([0.2, 1.1, -0.4, 0.0, 0.0, 0.0, 1.0]), 1.0, [0.0; 4]);
        let before = frame(&mut input, Value::Null, held()).space;
        assert_eq!(frame(&mut input, Value::Null, Value::Null).space, before, "a device that is lost is no other one");
        assert_ne!(frame(&mut input, Value::Null, tracked(1, [0.2, 1.1, -0.4], OPEN, None)).space, before);
    }

    #[test]
    fn wrong_joints_are_refused_by_name_or_are_no_hand() {
        let refused = |change: &dyn Fn(&mut Value)| {
            let mut hand = tracked(1, [0.0; 3], OPEN, None);
            change(&mut hand["hand"]);
            WebXr::default().read(&message(Value::Null, hand, true)).expect_err("refused").to_string()
        };
        let short = refused(&|hand| drop(hand["places"].as_array_mut().expect("joints").pop()));
        assert!(short.contains("74 numbers for a hand's joints; there must be 75"), "{short}");
        let old = refused(&|hand| hand["version"] = json!(2));
        assert!(old.contains("version 2") && old.contains("reload the page"), "{old}");
        let far = refused(&|hand| hand["places"][3] = json!(0.7));
        assert!(far.contains("a joint's place of the headset is 0.7"), "{far}");
        assert!(refused(&|hand| hand["places"][3] = json!(null)).contains("cannot read"));
        assert!(refused(&|hand| hand["places"] = json!(vec![0.0; 100_000])).contains("100000 numbers"));

        let mut hand = tracked(1, [0.0; 3], OPEN, None);
        hand["hand"]["places"] = json!(vec![0.0; 75]);
        let pinch = tracked(0, [0.0, 1.0, -0.3], OPEN, Some(1));
        let at = frame(&mut WebXr::default(), pinch, hand);
        assert_eq!(at.hands[1], Hand::default(), "joints in one place are no hand");
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
