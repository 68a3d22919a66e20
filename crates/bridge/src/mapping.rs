//! Between a model's keys and our robot: cameras, state, actions, and how a chunk is played. Read from TOML.

mod file;
mod shipped;

use fiatlux_robot::Robot;
use fiatlux_wbc::{CONTROL_DT, LEGS, MOVED};

use crate::hands::{Hands, Side};
use crate::image::Resize;
use crate::{BridgeError, Dialect};
pub use shipped::{default_mapping, shipped_names};

/// The three joints of the waist: yaw, roll, pitch.
pub const WAIST: std::ops::Range<usize> = LEGS..MOVED;

/// What the numbers of an action are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Representation {
    /// Targets.
    Absolute,
    /// Changes from row to row, from the posture at the question on.
    Delta,
    /// Changes from the posture at the question.
    Relative,
}

impl Representation {
    const ALL: [(&'static str, Self); 3] =
        [("absolute", Self::Absolute), ("delta", Self::Delta), ("relative", Self::Relative)];

    /// By its name, in any case.
    pub fn by_name(name: &str) -> Option<Self> {
        Self::ALL.iter().find(|(known, _)| known.eq_ignore_ascii_case(name)).map(|(_, known)| *known)
    }

    /// Its name.
    pub fn name(self) -> &'static str {
        Self::ALL[self as usize].0
    }
}

/// What moves legs and waist.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Body {
    /// The whole-body controller, on the commands of the model.
    Wbc,
    /// A decoder of motion tokens moves legs, waist and arms.
    Tokens,
    /// The model's own joint targets. Joints that it does not name keep the posture of the start.
    Direct,
}

/// Some numbers of a key, in order.
#[derive(Debug, Clone, PartialEq)]
pub enum Part {
    /// Joints of our robot by index, rad.
    Joints(Vec<usize>),
    /// The joints of the model's hand, retargeted from and to ours.
    Hand(Side),
    /// How far our hand is closed, with the numbers of open and closed.
    Grip {
        /// Which hand.
        side: Side,
        /// Number of an open hand.
        open: f64,
        /// Number of a closed hand.
        closed: f64,
    },
    /// Pose of a wrist in the pelvis frame: x, y, z, m, and the first two rows of its rotation.
    Wrist(Side),
    /// Direction of gravity in the pelvis frame: 3. This and the next four are of the state alone, as the robot senses them.
    Gravity,
    /// Angular velocity of the pelvis in its frame, rad/s: 3.
    AngularVelocity,
    /// Linear velocity of the pelvis in its frame, m/s: 3.
    LinearVelocity,
    /// Angles of all joints, that many, less the standing posture, rad.
    Turned(usize),
    /// Velocities of all joints, that many, rad/s.
    Velocities(usize),
    /// Forward, left, m/s, and turning velocity, rad/s: 3.
    Navigate,
    /// Height of the pelvis, m: 1.
    Height,
    /// Roll, pitch, yaw of the torso, rad: 3.
    Torso,
    /// A motion token.
    Token(usize),
    /// Numbers without a use: zeros in the state, ignored in actions.
    Skip(usize),
}

impl Part {
    /// Its count of numbers.
    pub fn width(&self, hands: Option<&Hands>) -> usize {
        match self {
            Self::Joints(joints) => joints.len(),
            Self::Hand(side) => hands.map_or(0, |hands| hands.width(*side)),
            Self::Wrist(_) => 9,
            Self::Gravity | Self::AngularVelocity | Self::LinearVelocity | Self::Navigate | Self::Torso => 3,
            Self::Grip { .. } | Self::Height => 1,
            Self::Turned(width) | Self::Velocities(width) | Self::Token(width) | Self::Skip(width) => *width,
        }
    }
}

/// A camera of the model.
#[derive(Debug, Clone, PartialEq)]
pub struct Camera {
    /// Key of the model.
    pub key: String,
    /// Sensor of ours: `camera` or `chest_camera`; none for a black picture.
    pub sensor: Option<String>,
    /// Width and height that the model gets, pixels.
    pub size: [u32; 2],
    /// How a picture of another size is fitted.
    pub resize: Resize,
    /// Which frames the model gets, in rows before now, the oldest first: 0 for the present one.
    pub delta: Vec<i64>,
}

/// A key of the state or the actions.
#[derive(Debug, Clone, PartialEq)]
pub struct Key {
    /// Its name.
    pub key: String,
    /// What its numbers are.
    pub parts: Vec<Part>,
    /// What the numbers are as they arrive. Of actions alone.
    pub representation: Representation,
    /// What the server's contract calls them, where that is something else: GR00T's server decodes relative actions itself.
    pub declared: Representation,
}

/// A checked mapping.
#[derive(Debug, Clone, PartialEq)]
pub struct Mapping {
    /// Its name, for the record.
    pub name: String,
    /// The dialects that it is of.
    pub dialects: Vec<Dialect>,
    /// What moves legs and waist.
    pub body: Body,
    /// Width and height that the session's cameras have, pixels.
    pub picture: [u32; 2],
    /// Between the fingers of the model and ours.
    pub hands: Option<Hands>,
    /// Rows that an answer has.
    pub horizon: usize,
    /// Rows that are played of each.
    pub prefix: usize,
    /// Rows a second.
    pub rate_hz: f64,
    /// Key of the instruction; empty where the model gets none.
    pub language: String,
    /// RoboArena's kind of actions; empty for any.
    pub action_space: String,
    /// The model's cameras.
    pub cameras: Vec<Camera>,
    /// The model's state.
    pub states: Vec<Key>,
    /// The model's actions.
    pub actions: Vec<Key>,
}

impl Mapping {
    /// Reads a mapping for a robot. `name` is for messages.
    ///
    /// # Errors
    /// [`BridgeError::Mapping`], with the field that is wrong.
    pub fn from_toml(name: &str, text: &str, robot: &Robot) -> Result<Self, BridgeError> {
        file::read(name, text, robot)
    }

    /// A mapping by the name of a shipped one, or by the path of a file.
    ///
    /// # Errors
    /// [`BridgeError::Mapping`].
    pub fn open(name: &str, robot: &Robot) -> Result<Self, BridgeError> {
        if let Some(text) = shipped::text(name) {
            return Self::from_toml(name, text, robot);
        }
        let text = std::fs::read_to_string(name).map_err(|error| BridgeError::Mapping {
            name: name.into(),
            field: "file".into(),
            problem: format!("{error}; give a file, or one of {}", shipped_names().join(", ")),
        })?;
        Self::from_toml(name, &text, robot)
    }

    /// Numbers of a key.
    pub fn width(&self, key: &Key) -> usize {
        key.parts.iter().map(|part| part.width(self.hands.as_ref())).sum()
    }

    /// Control steps of a row.
    pub fn steps_per_row(&self) -> f64 {
        1.0 / (self.rate_hz * CONTROL_DT)
    }

    /// The action key that holds motion tokens, and their width.
    pub fn token(&self) -> Option<(&str, usize)> {
        let width = |part: &Part| if let Part::Token(width) = part { Some(*width) } else { None };
        self.actions.iter().find_map(|key| Some((key.key.as_str(), key.parts.iter().find_map(width)?)))
    }

    /// What the record says: the mapping, and how its fingers are retargeted.
    pub fn label(&self) -> String {
        match &self.hands {
            Some(hands) => format!("{}:{}", self.name, hands.name),
            None => self.name.clone(),
        }
    }
}

#[cfg(test)]
mod tests;
