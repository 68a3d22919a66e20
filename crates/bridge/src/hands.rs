//! Converts between the fingers of a model's hand and those of our robot, by a piecewise linear table in TOML.

use fiatlux_robot::Robot;
use fiatlux_wbc::{ARMS, BODY, MOVED};
use serde::Deserialize;

use crate::BridgeError;

/// Side of the robot, from its own point of view.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Side {
    Left,
    Right,
}

impl Side {
    pub fn by_name(name: &str) -> Option<Self> {
        match name {
            "left" => Some(Self::Left),
            "right" => Some(Self::Right),
            _ => None,
        }
    }

    /// Indices of the seven joints of this arm.
    pub fn arm(self) -> std::ops::Range<usize> {
        match self {
            Self::Left => MOVED..MOVED + ARMS / 2,
            Self::Right => MOVED + ARMS / 2..BODY,
        }
    }

    pub fn wrist(self) -> &'static str {
        match self {
            Self::Left => "left_wrist_yaw_link",
            Self::Right => "right_wrist_yaw_link",
        }
    }
}

/// A joint of the model's hand: its angles when open and closed, and the joints of our hand that it moves.
#[derive(Debug, Clone, PartialEq)]
struct Finger {
    open: f64,
    closed: f64,
    /// A joint of our hand, with its angles when open and closed, rad.
    ours: Vec<(usize, f64, f64)>,
}

/// Retargeting between both hands of a model and ours.
#[derive(Debug, Clone, PartialEq)]
pub struct Hands {
    /// Name of the retargeting, for the record of an episode.
    pub name: String,
    left: Vec<Finger>,
    right: Vec<Finger>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    name: String,
    left: Vec<FileFinger>,
    right: Vec<FileFinger>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct FileFinger {
    joint: String,
    open: f64,
    closed: f64,
    ours: Vec<(String, f64, f64)>,
}

/// Largest file of a mapping or retargeting, bytes.
pub(crate) const MAX_MAPPING_BYTES: u64 = 1 << 20;
/// The retargetings that come with this program, by name.
const SHIPPED: [(&str, &str); 1] = include!("../hands/shipped.in");

impl Hands {
    /// Opens a retargeting by its name, or by the path of a file.
    pub fn open(name: &str, robot: &Robot) -> Result<Self, BridgeError> {
        let wrong =
            |field: &str, problem: String| BridgeError::Mapping { name: name.into(), field: field.into(), problem };
        let text = match SHIPPED.iter().find(|(known, _)| *known == name) {
            Some((_, text)) => (*text).to_owned(),
            None => fiatlux_files::read_text(name.as_ref(), MAX_MAPPING_BYTES).map_err(|error| {
                let known = SHIPPED.map(|(name, _)| name).join(", ");
                wrong("hands", format!("{error}; give a file, or one of {known}"))
            })?,
        };
        let file: File = toml::from_str(&text).map_err(|error| wrong("file", error.message().to_owned()))?;
        // A robot with the model's own hands needs no table.
        let mut fingers = file.left.iter().chain(&file.right);
        let is_own = fingers.all(|finger| robot.joint_index(&finger.joint).is_some());
        let side = |field: &str, fingers: Vec<FileFinger>| -> Result<Vec<Finger>, BridgeError> {
            let read = |mut finger: FileFinger| {
                if is_own {
                    finger.ours = vec![(finger.joint, finger.open, finger.closed)];
                }
                let ours = finger.ours.iter().map(|(joint, open, closed)| {
                    let found = robot.joint_index(joint).filter(|joint| *joint >= BODY);
                    let found = found.ok_or_else(|| {
                        wrong(
                            field,
                            format!("robot {} has no finger joint '{joint}'; use the robot with hands", robot.name()),
                        )
                    })?;
                    Ok((found, *open, *closed))
                });
                let ours = ours.collect::<Result<Vec<_>, BridgeError>>()?;
                let ends =
                    [finger.open, finger.closed].into_iter().chain(ours.iter().flat_map(|ours| [ours.1, ours.2]));
                let is_flat = finger.open == finger.closed || ours.iter().any(|(_, open, closed)| open == closed);
                if is_flat || ours.is_empty() || !ends.into_iter().all(f64::is_finite) {
                    return Err(wrong(
                        field,
                        "open and closed must be different finite angles, for joints of both hands".into(),
                    ));
                }
                Ok(Finger { open: finger.open, closed: finger.closed, ours })
            };
            fingers.into_iter().map(read).collect()
        };
        let name = if is_own { robot.hand().to_owned() } else { file.name };
        Ok(Self { left: side("left", file.left)?, right: side("right", file.right)?, name })
    }

    fn fingers(&self, side: Side) -> &[Finger] {
        match side {
            Side::Left => &self.left,
            Side::Right => &self.right,
        }
    }

    pub fn width(&self, side: Side) -> usize {
        self.fingers(side).len()
    }

    /// Indices of the joints of our hand that it moves.
    pub fn joints(&self, side: Side) -> Vec<usize> {
        self.fingers(side).iter().flat_map(|finger| finger.ours.iter().map(|ours| ours.0)).collect()
    }

    /// Joints and angles of our hand for angles of the model's hand, rad.
    pub fn ours(&self, side: Side, theirs: &[f64]) -> Vec<(usize, f64)> {
        let moves = |(finger, angle): (&Finger, &f64)| {
            let part = ((angle - finger.open) / (finger.closed - finger.open)).clamp(0.0, 1.0);
            finger.ours.iter().map(|(joint, open, closed)| (*joint, open + part * (closed - open))).collect::<Vec<_>>()
        };
        self.fingers(side).iter().zip(theirs).flat_map(moves).collect()
    }

    /// Angles of the model's hand for all joint angles of our robot, rad; each follows the first of our joints that it
    /// moves.
    pub fn theirs(&self, side: Side, q: &[f64]) -> Vec<f64> {
        let angle = |finger: &Finger| finger.open + closure(finger, q) * (finger.closed - finger.open);
        self.fingers(side).iter().map(angle).collect()
    }

    /// Joints and angles of our hand when closed to this share, from 0 (open) to 1.
    pub fn gripped(&self, side: Side, closed: f64) -> Vec<(usize, f64)> {
        let closed = closed.clamp(0.0, 1.0);
        let angle = |ours: &(usize, f64, f64)| (ours.0, ours.1 + closed * (ours.2 - ours.1));
        self.fingers(side).iter().flat_map(|finger| finger.ours.iter().map(angle)).collect()
    }

    /// Closure of our hand, from 0 (open) to 1: the mean over the model's joints.
    pub fn grip(&self, side: Side, q: &[f64]) -> f64 {
        let fingers = self.fingers(side);
        fingers.iter().map(|finger| closure(finger, q)).sum::<f64>() / fingers.len().max(1) as f64
    }
}

/// Closure of one finger of our hand, from 0 to 1.
fn closure(finger: &Finger, q: &[f64]) -> f64 {
    let Some(&(joint, open, closed)) = finger.ours.first() else { return 0.0 };
    let angle = q.get(joint).copied().unwrap_or(open);
    ((angle - open) / (closed - open)).clamp(0.0, 1.0)
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    /// Retargeting there and back is the identity, and each of our finger joints moves.
    #[test]
    fn dex3_and_inspire_are_retargeted_both_ways() {
        let robot = Robot::benchmark().unwrap();
        let hands = Hands::open("dex3-inspire-1", &robot).unwrap();
        for (side, fingers) in [(Side::Left, 29..41), (Side::Right, 41..53)] {
            let mut joints = hands.joints(side);
            joints.sort_unstable();
            assert_eq!(joints, fingers.collect::<Vec<_>>());
            assert_eq!(hands.width(side), 7);
            for part in [0.0, 0.25, 0.5, 1.0] {
                let ends = hands.fingers(side).iter();
                let theirs: Vec<f64> = ends.map(|finger| finger.open + part * (finger.closed - finger.open)).collect();
                let mut q = robot.q0().to_vec();
                for (joint, angle) in hands.ours(side, &theirs) {
                    let limits = &robot.joints()[joint];
                    assert!((limits.lower..=limits.upper).contains(&angle), "{} {angle}", limits.name);
                    q[joint] = angle;
                }
                let back = hands.theirs(side, &q);
                assert!(
                    back.iter().zip(&theirs).all(|(back, angle)| (back - angle).abs() < 1e-12),
                    "{back:?} {theirs:?}"
                );
                assert!((hands.grip(side, &q) - part).abs() < 1e-12);
            }
        }
        let bare = Robot::by_name("g1_bare").unwrap();
        assert!(Hands::open("dex3-inspire-1", &bare).unwrap_err().to_string().contains("use the robot with hands"));
    }

    /// A robot that has the model's hands plays its angles as they are.
    #[test]
    fn fingers_of_the_same_hand_are_not_retargeted() {
        let robot = Robot::by_name("g1_dex3").unwrap();
        let hands = Hands::open("dex3-inspire-1", &robot).unwrap();
        assert_eq!(hands.name, "dex3");
        for side in [Side::Left, Side::Right] {
            let theirs: Vec<f64> = hands.fingers(side).iter().map(|f| f.open + 0.3 * (f.closed - f.open)).collect();
            let mut q = robot.q0().to_vec();
            for ((joint, angle), wanted) in hands.ours(side, &theirs).into_iter().zip(&theirs) {
                assert!((angle - wanted).abs() < 1e-12);
                q[joint] = angle;
            }
            let back = hands.theirs(side, &q);
            assert!(back.iter().zip(&theirs).all(|(back, angle)| (back - angle).abs() < 1e-12), "{back:?} {theirs:?}");
        }
    }
}
