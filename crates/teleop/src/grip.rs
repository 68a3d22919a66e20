//! Fingers that close around a bulb without crushing it.

use std::collections::BTreeMap;

use fiatlux_proto::v3::SessionInfo;
use fiatlux_wbc::{BODY, CONTROL_DT};
use serde::Deserialize;

/// Fingers, as the names of bodies and joints have them. The thumb closes first.
const FINGERS: [&str; 5] = ["thumb", "index", "middle", "ring", "pinky"];
const SIDES: [&str; 2] = ["L_", "R_"];
/// Share of the way from open to closed in a second, and by how much of it the fingers are behind the thumb.
const RATE: f64 = 1.0;
const LAG: f64 = 0.3;
/// Fastest turn of a target, rad/s.
const MAX_TURN_RATE: f64 = 2.0;
/// A finger that a bulb presses with more than this, N, does not press harder than that with its joints, N m; their drives have
/// 0.5. Both are those of the policy `hands`.
const TOUCH_N: f64 = 1.0;
const TORQUE_NM: f64 = 0.3;

#[derive(Debug, Deserialize)]
struct Angles {
    open: BTreeMap<String, f64>,
    closed: BTreeMap<String, f64>,
}

/// A joint of a finger.
#[derive(Debug, Clone)]
struct Joint {
    /// Its index in the session.
    index: usize,
    side: usize,
    finger: usize,
    open: f64,
    closed: f64,
    limits: [f64; 2],
    q0: f64,
    stiffness: f64,
}

#[derive(Debug, Clone, Copy, Default)]
struct Finger {
    share: f64,
    has_touched: bool,
}

/// The fingers of both hands; none for a robot whose fingers are welded or that has other hands.
#[derive(Debug, Clone)]
pub(crate) struct Grips {
    joints: Vec<Joint>,
    /// Side and finger of each sensed hand body.
    bodies: Vec<Option<(usize, usize)>>,
    hands: [Option<[Finger; 5]>; 2],
}

/// Side, left first, and finger of a name.
fn place(name: &str) -> Option<(usize, usize)> {
    let side = SIDES.iter().position(|side| name.starts_with(side))?;
    Some((side, FINGERS.iter().position(|finger| name.contains(finger))?))
}

impl Grips {
    pub fn new(info: &SessionInfo) -> Result<Self, toml::de::Error> {
        let Angles { open, closed } = toml::from_str(include_str!("grip.toml"))?;
        let joint = |(index, joint): (usize, &fiatlux_proto::v3::Joint)| {
            let (side, finger) = place(&joint.name)?;
            let name = &joint.name[SIDES[side].len()..];
            Some(Joint {
                index,
                side,
                finger,
                open: open.get(name).copied().unwrap_or_default(),
                closed: *closed.get(name)?,
                limits: [joint.lower, joint.upper],
                q0: joint.q0,
                stiffness: joint.stiffness.max(1e-3),
            })
        };
        Ok(Self {
            joints: info.joints.iter().enumerate().skip(BODY).filter_map(joint).collect(),
            bodies: info.hand_bodies.iter().map(|name| place(name)).collect(),
            hands: [None; 2],
        })
    }

    /// Moves the targets of both hands for a control step. `close` has the share of each hand, left first; a hand without one
    /// stays as it is. `turned` are the sensed angles from q0, rad, `forces` those of the sensor `hand_contact`.
    pub fn step(&mut self, close: [Option<f64>; 2], turned: &[f32], forces: &[f32], targets: &mut [f64]) {
        let mut force = [[0.0_f64; 5]; 2];
        for (place, &[x, y, z]) in self.bodies.iter().zip(forces.as_chunks().0) {
            if let Some((side, finger)) = *place {
                let pressed = [x, y, z].iter().map(|part| f64::from(*part).powi(2)).sum::<f64>().sqrt();
                force[side][finger] = force[side][finger].max(pressed);
            }
        }
        for side in 0..2 {
            let Some(wanted) = close[side] else { continue };
            let joints = self.joints.iter().filter(|joint| joint.side == side);
            let hand = self.hands[side].get_or_insert_with(|| staged(joints.clone(), targets));
            let thumb = hand[0].share;
            for (index, (finger, force)) in hand.iter_mut().zip(force[side]).enumerate() {
                let behind = if index > 0 && thumb + 1e-9 < wanted { (thumb - LAG).max(0.0) } else { wanted };
                let goal = if finger.share < wanted { behind.max(finger.share).min(wanted) } else { wanted };
                finger.has_touched = (finger.has_touched || force > TOUCH_N) && goal >= finger.share;
                finger.share += (goal - finger.share).clamp(-RATE * CONTROL_DT, RATE * CONTROL_DT);
            }
            for joint in joints {
                let (Some(target), finger) = (targets.get_mut(joint.index), hand[joint.finger]) else { continue };
                let goal = joint.open + finger.share * (joint.closed - joint.open);
                let step = MAX_TURN_RATE * CONTROL_DT;
                let mut next = *target + (goal - *target).clamp(-step, step);
                if let (true, Some(turned)) = (finger.has_touched, turned.get(joint.index)) {
                    let (at, bend) = (joint.q0 + f64::from(*turned), TORQUE_NM / joint.stiffness);
                    next = next.clamp(at - bend, at + bend);
                }
                *target = next.clamp(joint.limits[0], joint.limits[1]);
            }
        }
    }
}

/// Closure of a hand's fingers by their targets.
fn staged<'a>(joints: impl Iterator<Item = &'a Joint>, targets: &[f64]) -> [Finger; 5] {
    let mut sums = [[0.0_f64; 2]; 5];
    for joint in joints {
        let (way, target) = (joint.closed - joint.open, targets.get(joint.index).copied().unwrap_or(joint.open));
        sums[joint.finger][0] += way * (target - joint.open);
        sums[joint.finger][1] += way * way;
    }
    sums.map(|[along, way]| Finger { share: (along / way.max(1e-9)).clamp(0.0, 1.0), has_touched: false })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn info() -> SessionInfo {
        let robot = fiatlux_robot::Robot::by_name("g1_inspire").expect("the robot");
        let joint = |joint: &fiatlux_robot::Joint| fiatlux_proto::v3::Joint {
            name: joint.name.clone(),
            lower: joint.lower,
            upper: joint.upper,
            stiffness: joint.gains.stiffness,
            ..fiatlux_proto::v3::Joint::default()
        };
        SessionInfo {
            joints: robot.joints().iter().map(joint).collect(),
            hand_bodies: robot.hand_links().iter().map(|link| robot.links()[*link].name.clone()).collect(),
            ..SessionInfo::default()
        }
    }

    fn finger(info: &SessionInfo, name: &str) -> usize {
        info.joints.iter().position(|joint| joint.name == name).expect("a joint")
    }

    #[test]
    fn the_thumb_closes_first_and_all_arrive() {
        let info = info();
        let mut grips = Grips::new(&info).expect("data");
        assert_eq!(grips.joints.len(), 24);
        let mut targets = vec![0.0; info.joints.len()];
        let (thumb, index) = (finger(&info, "R_thumb_distal_joint"), finger(&info, "R_index_proximal_joint"));
        for _ in 0..12 {
            grips.step([None, Some(1.0)], &[], &[], &mut targets);
        }
        assert!(targets[thumb] > 0.1 && targets[index].abs() < 1e-9, "{} {}", targets[thumb], targets[index]);
        for _ in 0..90 {
            grips.step([None, Some(1.0)], &[], &[], &mut targets);
        }
        assert!((targets[thumb] - 0.8376).abs() < 1e-9 && (targets[index] - 1.5623).abs() < 1e-9);
        assert!(targets[finger(&info, "L_index_proximal_joint")].abs() < 1e-12, "the other hand stays");
    }

    /// A finger that feels the bulb where it is goes no further than its torque bends the drive.
    #[test]
    fn a_finger_that_touches_presses_no_harder() {
        let info = info();
        let mut grips = Grips::new(&info).expect("data");
        let mut targets = vec![0.0; info.joints.len()];
        let index = finger(&info, "R_index_proximal_joint");
        let body = info.hand_bodies.iter().position(|name| name == "R_index_intermediate").expect("a body");
        let mut forces = vec![0.0; 3 * info.hand_bodies.len()];
        forces[3 * body] = 3.0;
        let mut turned = vec![0.0; info.joints.len()];
        turned[index] = 0.5;
        for _ in 0..200 {
            grips.step([None, Some(1.0)], &turned, &forces, &mut targets);
        }
        let bend = TORQUE_NM / info.joints[index].stiffness;
        assert!((targets[index] - 0.5 - bend).abs() < 1e-6, "{}", targets[index]);
        forces[3 * body] = 0.0;
        for _ in 0..200 {
            grips.step([None, Some(0.0)], &turned, &forces, &mut targets);
        }
        assert!(targets[index].abs() < 1e-9, "it opens");
    }
}
