//! Made-up input: random poses, lost frames, numbers that no device gives, late messages, other pages. Whatever arrives, nothing
//! panics, and the robot stands when input is gone.

use std::collections::VecDeque;

use fiatlux_teleop::Inputs;
use rand_pcg::Pcg64Mcg;
use rand_pcg::rand_core::Rng;
use serde_json::{Value, json};

use crate::common::drive;

/// Length of an episode, control steps, and number of episodes: half a minute by default; two hours with all mutations.
const STEPS: u64 = 1500;

fn episodes() -> u64 {
    let is_set = |name: &str| std::env::var_os(name).is_some_and(|value| value == "1");
    match (is_set("FIATLUX_ALL_MUTATIONS"), is_set("FIATLUX_SLOW_TESTS")) {
        (true, _) => 240,
        (_, true) => 4,
        _ => 1,
    }
}

/// Input comes for the first part of each period, and is gone for the rest, control steps.
const PERIOD: u64 = 300;
const PRESENT: u64 = 150;
/// When a robot without input has come to rest, control steps, and how far it then still moves, m.
const RESTS: u64 = 90;
const MAX_DRIFT_M: f64 = 0.1;

struct Chaos(Pcg64Mcg);

impl Chaos {
    fn share(&mut self) -> f64 {
        f64::from(self.0.next_u32()) / f64::from(u32::MAX)
    }

    fn around(&mut self, size: f64) -> f64 {
        (2.0 * self.share() - 1.0) * size
    }

    fn one_in(&mut self, count: u32) -> bool {
        self.0.next_u32().is_multiple_of(count)
    }

    fn number(&mut self) -> Value {
        match self.0.next_u32() % 6 {
            0 => Value::Null,
            1 => json!(1e300),
            2 => json!("NaN"),
            3 => json!([]),
            4 => json!(-0.0),
            _ => json!(self.around(1e9)),
        }
    }

    fn controller(&mut self) -> Value {
        if self.one_in(12) {
            return Value::Null;
        }
        let pose: Vec<Value> = (0..7).map(|_| json!(self.around(1.0))).collect();
        let pose = if self.one_in(8) { Value::Null } else { json!(pose) };
        let buttons: Vec<f64> = (0..6).map(|_| self.share()).collect();
        let axes: Vec<f64> = (0..4).map(|_| self.around(1.0)).collect();
        let mut controller = json!({ "pose": pose, "buttons": buttons, "axes": axes });
        if self.one_in(3) {
            // Joints of no hand, of which some pinch.
            let size = if self.one_in(2) { 0.01 } else { 0.1 };
            let count = if self.one_in(20) { 74 } else { 75 };
            let places: Vec<f64> = (0..count).map(|_| self.around(size)).collect();
            controller["hand"] = json!({ "version": 1, "places": places });
        }
        controller
    }

    /// A message of an input; one in ten is broken.
    fn message(&mut self) -> (&'static str, Value) {
        let (name, mut message) = match self.0.next_u32() % 3 {
            0 => {
                let keys = ["KeyW", "KeyS", "KeyQ", "KeyE", "KeyI", "KeyO", "Space", "Digit1", "KeyR", "KeyF", "KeyG"];
                let held: Vec<&str> = keys.into_iter().filter(|_| self.one_in(3)).collect();
                ("keyboard", json!({ "keys": held, "focused": !self.one_in(10), "running": true }))
            }
            1 => {
                let axes: Vec<f64> = (0..4).map(|_| self.around(1.0)).collect();
                let buttons: Vec<f64> = (0..17).map(|_| self.share()).collect();
                ("gamepad", json!({ "axes": axes, "buttons": buttons, "connected": !self.one_in(10), "running": true }))
            }
            _ => {
                let space = u64::from(self.one_in(10));
                let (left, right) = (self.controller(), self.controller());
                let heading = self.around(3.2);
                let visible = !self.one_in(10);
                let data = json!({
                    "space": space, "visible": visible, "left": left, "right": right, "heading": heading, "running": true
                });
                ("webxr", data)
            }
        };
        if self.one_in(10) {
            let broken = self.number();
            let fields = message.as_object_mut().expect("an object");
            let place = self.0.next_u32() as usize % fields.len();
            if let Some((_, value)) = fields.iter_mut().nth(place) {
                *value = broken;
            }
        }
        (name, message)
    }
}

#[test]
fn made_up_input_breaks_nothing_and_a_robot_without_input_stands() {
    let (mut refused, mut falls, mut worst) = (0, 0, 0.0_f64);
    for episode in 0..episodes() {
        let mut chaos = Chaos(Pcg64Mcg::new(0xcafe + u128::from(episode)));
        let mut inputs = Inputs::default();
        // Messages arrive up to 200 ms late, and in order.
        let mut under_way: VecDeque<(u64, &'static str, Value)> = VecDeque::new();
        let mut frame = None;
        let mut rested = None;
        let (mut has_fallen, mut drift) = (false, 0.0_f64);
        drive(
            "S07",
            1000 + episode,
            STEPS,
            Box::new(|seen| {
                let at = seen.pelvis.translation.vector;
                assert!(at.iter().all(|part| part.is_finite()));
                has_fallen |= at.z < 0.5;
                let place = seen.step % PERIOD;
                if place < PRESENT {
                    let after = under_way.back().map_or(0, |(due, ..)| *due);
                    let (name, message) = chaos.message();
                    let late = u64::from(chaos.0.next_u32() % 11);
                    under_way.push_back((after.max(seen.step + late), name, message));
                    if chaos.one_in(50) {
                        // Another page.
                        under_way.clear();
                        inputs = Inputs::default();
                        frame = None;
                    }
                    rested = None;
                } else {
                    under_way.clear();
                    frame = None;
                }
                while under_way.front().is_some_and(|(due, ..)| *due <= seen.step) {
                    let Some((_, name, message)) = under_way.pop_front() else { break };
                    match inputs.read(name, &message) {
                        Ok(reading) => frame = reading.frame,
                        Err(error) => {
                            assert!(!error.to_string().is_empty());
                            (refused, frame) = (refused + 1, None);
                        }
                    }
                }
                if place >= PRESENT + RESTS && !has_fallen {
                    let from = *rested.get_or_insert(at);
                    drift = drift.max((at - from).xy().norm());
                }
                frame.clone()
            }),
        );
        falls += u64::from(has_fallen);
        worst = worst.max(drift);
        assert!(drift < MAX_DRIFT_M, "episode {episode}: it moves {drift} m without input");
    }
    println!(
        "{} episodes of {STEPS} steps, {refused} messages refused, {falls} falls, {worst:.3} m of drift",
        episodes()
    );
    assert!(refused > 0, "some messages are broken");
}
