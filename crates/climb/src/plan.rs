//! Plans as data.

use std::fmt::Write;

use fiatlux_robot::{BODY, mirrored};
use nalgebra::{Isometry3, Quaternion, UnitQuaternion, Vector3};
use thiserror::Error;

/// Numbers of a line: seconds, what each foot bears, its two ranges, the pelvis and the joints.
const NUMBERS: usize = 7 + 7 + BODY;
/// Numbers in the file are whole; so many of them are 1 m, rad or s.
const UNIT: f64 = 1e4;
/// Largest speed of a joint, rad/s.
const RATE: f64 = 0.5;

/// A posture of a plan.
#[derive(Debug, Clone, PartialEq)]
pub struct Keyframe {
    /// Time from the posture before to this one, s.
    pub seconds: f64,
    /// Part of the weight that each foot may bear, left first; 1 sets no limit.
    pub bears: [f64; 2],
    /// Bearing part of each sole: from its rear to its front, from the sole's middle, m.
    pub ranges: [[f64; 2]; 2],
    /// Pelvis in the plan's frame.
    pub pelvis: Isometry3<f64>,
    /// Angles of legs, waist and arms, rad.
    pub angles: Vec<f64>,
}

impl Keyframe {
    fn mirror(&mut self) {
        self.bears.reverse();
        self.ranges.reverse();
        let (at, turn) = (self.pelvis.translation.vector, self.pelvis.rotation);
        let turn = UnitQuaternion::new_unchecked(Quaternion::new(turn.w, -turn.i, turn.j, -turn.k));
        self.pelvis = Isometry3::from_parts(Vector3::new(at.x, -at.y, at.z).into(), turn);
        let angle = |joint| {
            let (from, sign) = mirrored(joint);
            sign * self.angles[from]
        };
        self.angles = (0..self.angles.len()).map(angle).collect();
    }
}

/// Postures in a row. In the plan of the ladder, the frame's x leads from the steps into the ladder, z up, and its origin is
/// the ladder's.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Plan {
    /// In their order.
    pub keyframes: Vec<Keyframe>,
}

/// A line of a plan that cannot be read.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("line {line} of the plan does not hold {NUMBERS} whole numbers with a time and a rotation; make the plan anew")]
pub struct PlanError {
    /// From 1.
    pub line: usize,
}

impl Plan {
    /// Reads a plan that [`Plan::write`] wrote.
    ///
    /// # Errors
    /// A line that does not hold a keyframe.
    pub fn read(text: &str) -> Result<Self, PlanError> {
        let mut keyframes = Vec::new();
        for (index, line) in text.lines().enumerate().filter(|(_, line)| !line.starts_with('#')) {
            let wrong = PlanError { line: index + 1 };
            let numbers: Result<Vec<i32>, _> = line.split_whitespace().map(str::parse).collect();
            let numbers = numbers.map_err(|_| wrong.clone())?;
            let n: Vec<f64> = numbers.into_iter().map(|number| f64::from(number) / UNIT).collect();
            if n.len() != NUMBERS || n[0] <= 0.0 || n[10..14].iter().all(|part| *part == 0.0) {
                return Err(wrong);
            }
            let rotation = UnitQuaternion::from_quaternion(Quaternion::new(n[10], n[11], n[12], n[13]));
            keyframes.push(Keyframe {
                seconds: n[0],
                bears: [n[1], n[2]],
                ranges: [[n[3], n[4]], [n[5], n[6]]],
                pelvis: Isometry3::from_parts(Vector3::new(n[7], n[8], n[9]).into(), rotation),
                angles: n[14..].to_vec(),
            });
        }
        Ok(Self { keyframes })
    }

    /// The plan as text: a line for each keyframe, whole numbers of 0.1 mm, 0.1 mrad and 0.1 ms.
    pub fn write(&self) -> String {
        let mut text = String::from("# seconds, bears 2, ranges 4, pelvis 3 and quaternion 4, joints 29; in 1e-4\n");
        for key in &self.keyframes {
            let q = key.pelvis.rotation;
            let mut numbers = vec![key.seconds];
            numbers.extend(key.bears.iter().chain(key.ranges.as_flattened()));
            numbers.extend(key.pelvis.translation.vector.iter());
            numbers.extend([q.w, q.i, q.j, q.k]);
            numbers.extend(&key.angles);
            let words: Vec<String> =
                numbers.iter().map(|number| format!("{}", (number * UNIT).round() as i64)).collect();
            let _ = writeln!(text, "{}", words.join(" "));
        }
        text
    }

    /// Adds keyframes, each with at least the time that its joints need.
    pub fn extend(&mut self, keyframes: impl IntoIterator<Item = Keyframe>) {
        for mut key in keyframes {
            if let Some(last) = self.keyframes.last() {
                let changes = last.angles.iter().zip(&key.angles).map(|(a, b)| (a - b).abs());
                key.seconds = key.seconds.max(changes.fold(0.0, f64::max) / RATE);
            }
            self.keyframes.push(key);
        }
    }

    /// The same postures from the last to the first.
    #[must_use]
    pub fn reversed(&self) -> Self {
        let mut keyframes: Vec<Keyframe> = self.keyframes.iter().rev().cloned().collect();
        let times = self.keyframes.iter().rev().map(|key| key.seconds);
        keyframes.iter_mut().skip(1).zip(times).for_each(|(key, seconds)| key.seconds = seconds);
        Self { keyframes }
    }

    /// The same in the frame's mirror, whose y is turned round: the left foot does what the right one did.
    #[must_use]
    pub fn mirrored(&self) -> Self {
        let mut plan = self.clone();
        plan.keyframes.iter_mut().for_each(Keyframe::mirror);
        plan
    }

    /// Time of the whole plan, s.
    pub fn seconds(&self) -> f64 {
        self.keyframes.iter().map(|key| key.seconds).sum()
    }

    /// The posture at a time from its start, s; before it and beyond its end, the first and the last one. `None` for a plan
    /// without keyframes.
    pub fn at(&self, time: f64) -> Option<Keyframe> {
        let (mut start, mut before) = (0.0, self.keyframes.first()?);
        for key in &self.keyframes {
            let part = (time - start) / key.seconds;
            if part < 1.0 {
                return Some(between(before, key, part.max(0.0)));
            }
            start += key.seconds;
            before = key;
        }
        Some(before.clone())
    }
}

/// The bearing parts are those of the posture ahead.
fn between(before: &Keyframe, key: &Keyframe, part: f64) -> Keyframe {
    let mix = |a: f64, b: f64| a + part * (b - a);
    Keyframe {
        seconds: key.seconds,
        bears: [0, 1].map(|side| mix(before.bears[side], key.bears[side])),
        ranges: key.ranges,
        pelvis: Isometry3::from_parts(
            before.pelvis.translation.vector.lerp(&key.pelvis.translation.vector, part).into(),
            before.pelvis.rotation.slerp(&key.pelvis.rotation, part),
        ),
        angles: before.angles.iter().zip(&key.angles).map(|(a, b)| mix(*a, *b)).collect(),
    }
}
