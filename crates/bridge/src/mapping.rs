//! Maps a model's keys to our robot: cameras, state, actions, and how to play a chunk. Read from TOML.

mod file;
mod shipped;

use fiatlux_robot::Robot;
use fiatlux_wbc::{CONTROL_DT, LEGS, MOVED};

use crate::hands::{Hands, MAX_MAPPING_BYTES, Side};
use crate::image::Resize;
use crate::{BridgeError, Dialect, Representation};
pub use shipped::{default_mapping, shipped_names};

/// Indices of the three joints of the waist: yaw, roll, pitch.
pub const WAIST: std::ops::Range<usize> = LEGS..MOVED;

/// The source of the commands for legs and waist.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Body {
    /// The whole-body controller, following the model's commands.
    Wbc,
    /// The decoder of motion tokens, which also moves the arms.
    Tokens,
    /// The model's own joint targets. Joints without a target keep the posture of the start.
    Direct,
}

/// Consecutive numbers of a key with one meaning.
#[derive(Debug, Clone, PartialEq)]
pub enum KeyPart {
    /// Angles of these joints of our robot, by index, rad.
    Joints(Vec<usize>),
    /// Joints of the model's hand, retargeted to and from ours.
    Hand(Side),
    /// Closure of our hand, scaled between the two numbers for open and closed.
    Grip { side: Side, open: f64, closed: f64 },
    /// Pose of a wrist in the pelvis frame: x, y, z in m, and the first two rows of its rotation.
    Wrist(Side),
    /// Direction of gravity in the pelvis frame: 3 numbers. This part and the next six occur only in the state.
    Gravity,
    /// Angular velocity of the pelvis in its frame, rad/s: 3 numbers.
    AngularVelocity,
    /// Linear velocity of the pelvis in its frame, m/s: 3 numbers.
    LinearVelocity,
    /// Angles of all joints relative to the standing posture, rad; with the number of joints.
    Turned(usize),
    /// Velocities of all joints, rad/s; with the number of joints.
    Velocities(usize),
    /// Forces on the bodies of both hands as the sensor `hand_contact` has them, right hand first, world axes, N; each number
    /// is clamped to plus and minus `limit`. With the number of values.
    Contact { width: usize, limit: f32 },
    /// Nearest range of the LiDAR in each of these sectors, m, from behind by the left.
    Lidar { sectors: usize },
    /// Velocity forwards and to the left, m/s, and turning velocity, rad/s: 3 numbers.
    Navigate,
    /// Height of the pelvis, m: 1 number.
    Height,
    /// Roll, pitch and yaw of the torso, rad: 3 numbers.
    Torso,
    /// A motion token; with its number of values.
    Token(usize),
    /// Unused numbers: zeros in the state, ignored in actions.
    Skip(usize),
}

impl KeyPart {
    /// Number of values of the part; [`KeyPart::Hand`] needs `hands`.
    pub fn width(&self, hands: Option<&Hands>) -> usize {
        match self {
            Self::Joints(joints) => joints.len(),
            Self::Hand(side) => hands.map_or(0, |hands| hands.width(*side)),
            Self::Wrist(_) => 9,
            Self::Gravity | Self::AngularVelocity | Self::LinearVelocity | Self::Navigate | Self::Torso => 3,
            Self::Grip { .. } | Self::Height => 1,
            Self::Contact { width, .. } | Self::Lidar { sectors: width } => *width,
            Self::Turned(width) | Self::Velocities(width) | Self::Token(width) | Self::Skip(width) => *width,
        }
    }
}

#[derive(Debug, Clone, PartialEq)]
pub struct Camera {
    pub key: String,
    /// Sensor of our robot: `camera` or `chest_camera`; `None` for a black picture.
    pub sensor: Option<String>,
    /// Width and height of the picture that the model gets, pixels.
    pub size: [u32; 2],
    pub resize: Resize,
    /// Frames that the model gets, in rows relative to the present, oldest first: 0 for the current one.
    pub delta: Vec<i64>,
}

/// A key of the state or the actions.
#[derive(Debug, Clone, PartialEq)]
pub struct Key {
    pub key: String,
    /// Meaning of its numbers, in order.
    pub parts: Vec<KeyPart>,
    /// Meaning of the numbers when they arrive; used only for actions.
    pub representation: Representation,
    /// Their name in the server's contract, which may differ: GR00T's server decodes relative actions itself.
    pub declared: Representation,
}

/// A mapping that has passed all checks for a robot.
#[derive(Debug, Clone, PartialEq)]
pub struct Mapping {
    pub name: String,
    pub dialects: Vec<Dialect>,
    pub body: Body,
    /// Angles of arms are those at which they rest: their weight is compensated. Only with [`Body::Wbc`].
    pub hold_arms: bool,
    /// Where the robot stands still, commands may bend it lower than our controller can walk. Only with [`Body::Wbc`].
    pub bend_low: bool,
    /// Width and height of the pictures of the session's cameras, pixels.
    pub picture: [u32; 2],
    /// Retargeting of the fingers; `None` if the model has no hands.
    pub hands: Option<Hands>,
    pub horizon: usize,
    /// Number of rows to play before the next chunk.
    pub prefix: usize,
    pub rate_hz: f64,
    /// The LiDAR also sees bench, crate and walls.
    pub lidar_sees_room: bool,
    /// Key of the instruction; empty if the model gets none.
    pub language: String,
    /// Kind of actions in RoboArena's words; empty to accept any.
    pub action_space: String,
    pub cameras: Vec<Camera>,
    pub states: Vec<Key>,
    pub actions: Vec<Key>,
}

impl Mapping {
    /// Parses and checks a mapping for a robot. Errors call it `name`.
    pub fn from_toml(name: &str, text: &str, robot: &Robot) -> Result<Self, BridgeError> {
        file::read(name, text, robot)
    }

    /// Opens a mapping that comes with this program by its name, or another by the path of its file.
    pub fn open(name: &str, robot: &Robot) -> Result<Self, BridgeError> {
        if let Some(text) = shipped::text(name) {
            return Self::from_toml(name, text, robot);
        }
        let text =
            fiatlux_files::read_text(name.as_ref(), MAX_MAPPING_BYTES).map_err(|error| BridgeError::Mapping {
                name: name.into(),
                field: "file".into(),
                problem: format!("{error}; give a file, or one of {}", shipped_names().join(", ")),
            })?;
        Self::from_toml(name, &text, robot)
    }

    pub fn width(&self, key: &Key) -> usize {
        key.parts.iter().map(|part| part.width(self.hands.as_ref())).sum()
    }

    pub fn steps_per_row(&self) -> f64 {
        1.0 / (self.rate_hz * CONTROL_DT)
    }

    /// The action key that holds motion tokens, and the size of a token.
    pub fn token(&self) -> Option<(&str, usize)> {
        let width = |part: &KeyPart| if let KeyPart::Token(width) = part { Some(*width) } else { None };
        self.actions.iter().find_map(|key| Some((key.key.as_str(), key.parts.iter().find_map(width)?)))
    }

    pub fn label(&self) -> String {
        match &self.hands {
            Some(hands) => format!("{}:{}", self.name, hands.name),
            None => self.name.clone(),
        }
    }
}

#[cfg(test)]
mod tests;
