//! Turns the numbers of a chunk into targets and commands for our robot.

use std::collections::BTreeMap;

use fiatlux_robot::Robot;
use nalgebra::{UnitQuaternion, Vector3};

use crate::mapping::{Body, Key, KeyPart, Mapping, WAIST};
use crate::reach::{pose, reach, wrist};
use crate::representation::Representation;
use crate::{BridgeError, ModelChunk};

/// Targets and commands of one row of a chunk; `None` or empty if the model gives none.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Row {
    /// Joint index and target, rad, within the joint's limits, sorted by joint.
    pub targets: Vec<(usize, f64)>,
    /// Velocity forwards and to the left, m/s, and turning velocity, rad/s.
    pub velocity: Option<[f64; 3]>,
    /// Height of the pelvis, m.
    pub height: Option<f64>,
    /// Roll, pitch and yaw of the torso, rad.
    pub torso: Option<[f64; 3]>,
    /// A motion token as it arrived; empty if the model outputs none. Its decoder checks the numbers.
    pub token: Vec<f64>,
}

impl Row {
    /// Interpolates between two rows of one mapping: at `part` from 0 (this row) to 1 (`other`).
    pub fn towards(&self, other: &Self, part: f64) -> Self {
        let mix = |from: f64, to: f64| from + part * (to - from);
        let mix_three = |from: [f64; 3], to: [f64; 3]| [0, 1, 2].map(|axis| mix(from[axis], to[axis]));
        Self {
            targets: self.targets.iter().zip(&other.targets).map(|(from, to)| (from.0, mix(from.1, to.1))).collect(),
            velocity: self.velocity.zip(other.velocity).map(|(from, to)| mix_three(from, to)),
            height: self.height.zip(other.height).map(|(from, to)| mix(from, to)),
            torso: self.torso.zip(other.torso).map(|(from, to)| mix_three(from, to)),
            token: self.token.iter().zip(&other.token).map(|(from, to)| mix(*from, *to)).collect(),
        }
    }
}

/// The posture at the request, to which relative actions add.
struct Base<'a> {
    robot: &'a Robot,
    q: &'a [f64],
}

impl Mapping {
    /// Converts a chunk, after checking it with [`crate::check_chunk`]. `q` are the angles of all joints at the
    /// request, rad.
    ///
    /// # Errors
    /// [`BridgeError::Contract`]: the chunk does not match; [`BridgeError::Malformed`]: a wrist's numbers define no
    /// rotation.
    pub fn rows(&self, robot: &Robot, q: &[f64], chunk: &ModelChunk) -> Result<Vec<Row>, BridgeError> {
        crate::check_chunk(self, chunk)?;
        let base = Base { robot, q };
        let mut rows = Vec::with_capacity(chunk.rows);
        // Angles of the previous row, from which a wrist is reached, and sums of changes by key.
        let mut last = q.to_vec();
        let mut sums: Vec<Vec<f64>> = self.actions.iter().map(|key| vec![0.0; self.width(key)]).collect();
        for at in 0..chunk.rows {
            let mut row = Row::default();
            let mut targets = BTreeMap::new();
            for (key, sum) in self.actions.iter().zip(&mut sums) {
                let Some((_, width, numbers)) = chunk.parts.iter().find(|(name, ..)| *name == key.key) else {
                    continue;
                };
                let numbers = &numbers[at * width..(at + 1) * width];
                self.read_key(&base, key, numbers, sum, &mut last, &mut row, &mut targets)?;
            }
            if self.body == Body::Wbc {
                let waist = WAIST.map(|joint| targets.remove(&joint)).collect::<Option<Vec<f64>>>();
                if let Some(&[yaw, roll, pitch]) = waist.as_deref() {
                    row.torso = Some(leaned(yaw, roll, pitch));
                }
            }
            for (joint, target) in targets {
                let limits = &robot.joints()[joint];
                let target = target.clamp(limits.lower, limits.upper);
                last[joint] = target;
                row.targets.push((joint, target));
            }
            rows.push(row);
        }
        Ok(rows)
    }

    fn read_key(
        &self,
        base: &Base<'_>,
        key: &Key,
        numbers: &[f64],
        sum: &mut [f64],
        last: &mut [f64],
        row: &mut Row,
        targets: &mut BTreeMap<usize, f64>,
    ) -> Result<(), BridgeError> {
        sum.iter_mut().zip(numbers).for_each(|(sum, number)| *sum += number);
        let changes = match key.representation {
            Representation::Delta => sum as &[f64],
            _ => numbers,
        };
        let is_change = key.representation != Representation::Absolute;
        let mut from = 0;
        for part in &key.parts {
            let width = part.width(self.hands.as_ref());
            let values = &changes[from..from + width];
            from += width;
            match (part, &self.hands) {
                (KeyPart::Joints(joints), _) => {
                    for (joint, value) in joints.iter().zip(values) {
                        let start = if is_change { base.q[*joint] } else { 0.0 };
                        targets.insert(*joint, start + value);
                    }
                }
                (KeyPart::Hand(side), Some(hands)) => {
                    let start = if is_change { hands.theirs(*side, base.q) } else { vec![0.0; width] };
                    let theirs: Vec<f64> = start.iter().zip(values).map(|(start, value)| start + value).collect();
                    targets.extend(hands.ours(*side, &theirs));
                }
                (KeyPart::Grip { side, open, closed }, Some(hands)) => {
                    targets.extend(hands.gripped(*side, (values[0] - open) / (closed - open)));
                }
                (KeyPart::Wrist(side), _) => {
                    let wrong =
                        || BridgeError::malformed(format!("the action '{}'", key.key), "a rotation has no direction");
                    // Changes of a pose are multiplied, not added: each row is relative to the wrist at the request, or
                    // to the previous row.
                    let said = pose(&numbers[from - width..from]).ok_or_else(wrong)?;
                    let target = match key.representation {
                        Representation::Absolute => said,
                        Representation::Relative => wrist(base.robot, *side, base.q)? * said,
                        Representation::Delta => wrist(base.robot, *side, last)? * said,
                    };
                    reach(base.robot, *side, &target, last)?;
                    targets.extend(side.arm().map(|joint| (joint, last[joint])));
                }
                (KeyPart::Navigate, _) => row.velocity = values.try_into().ok(),
                (KeyPart::Height, _) => row.height = values.first().copied(),
                (KeyPart::Torso, _) => row.torso = values.try_into().ok(),
                (KeyPart::Token(_), _) => row.token = values.to_vec(),
                _ => {}
            }
        }
        Ok(())
    }
}

/// Roll, pitch and yaw of a torso on a waist with three joints.
fn leaned(yaw: f64, roll: f64, pitch: f64) -> [f64; 3] {
    let about = |axis: Vector3<f64>, angle| UnitQuaternion::from_scaled_axis(axis * angle);
    let turn = about(Vector3::z(), yaw) * about(Vector3::x(), roll) * about(Vector3::y(), pitch);
    let (roll, pitch, yaw) = turn.euler_angles();
    [roll, pitch, yaw]
}
