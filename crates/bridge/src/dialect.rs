//! What a model server is asked and answers, whatever its dialect.

mod gr00t;
mod openpi;

use std::str::FromStr;

use crate::mapping::Representation;
use crate::net::Timeouts;
use crate::{BridgeError, Tensor};

/// How a model server speaks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Dialect {
    /// Isaac GR00T N1.6 and N1.7: ZeroMQ, nested keys.
    Gr00t,
    /// The same with the server's flag `--use-sim-policy-wrapper`: flat keys.
    Gr00tFlat,
    /// The same, of a model that speaks motion tokens of GEAR-SONIC.
    Gr00tSonic,
    /// openpi: WebSocket.
    Openpi,
    /// openpi as the BEHAVIOR challenge has it: a reset without a reply, chunks on request.
    Behavior,
    /// openpi as RoboArena has it: a config first, endpoints, bare arrays.
    Roboarena,
}

impl Dialect {
    /// All, by the names of the command line.
    pub const ALL: [(&'static str, Self); 6] = [
        ("gr00t", Self::Gr00t),
        ("gr00t-flat", Self::Gr00tFlat),
        ("gr00t-sonic", Self::Gr00tSonic),
        ("openpi", Self::Openpi),
        ("behavior", Self::Behavior),
        ("roboarena", Self::Roboarena),
    ];

    /// Its name on the command line.
    pub fn name(self) -> &'static str {
        Self::ALL[self as usize].0
    }
}

impl FromStr for Dialect {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        let found = Self::ALL.iter().find(|(known, _)| *known == name);
        let names = || Self::ALL.map(|(name, _)| name).join(", ");
        found.map(|(_, dialect)| *dialect).ok_or_else(|| format!("'{name}' is not a known dialect; use {}", names()))
    }
}

/// What a server says of a camera.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct CameraTerms {
    /// Key of its pictures.
    pub key: String,
    /// Width and height, pixels, where the server says them.
    pub size: Option<[u32; 2]>,
    /// Which frames it wants, in rows before now: 0 for the present one.
    pub delta: Option<Vec<i64>>,
}

/// What a server says of a key of the actions.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ActionTerms {
    /// The key.
    pub key: String,
    /// Numbers a row, where the server says so.
    pub width: Option<usize>,
    /// How its model speaks, where the server says so.
    pub representation: Option<Representation>,
}

/// What a server says of itself. What it leaves out is [`None`] and cannot be compared before its first answer.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Contract {
    /// The cameras that it wants.
    pub cameras: Option<Vec<CameraTerms>>,
    /// How many cameras it wants, where it does not name them.
    pub camera_count: Option<usize>,
    /// Width and height of all pictures, pixels.
    pub image_size: Option<[u32; 2]>,
    /// The keys of the state that it wants, with the numbers of each where the server says so.
    pub states: Option<Vec<(String, Option<usize>)>>,
    /// How many frames of the state it wants.
    pub state_frames: Option<usize>,
    /// The keys that it answers with.
    pub actions: Option<Vec<ActionTerms>>,
    /// Keys of the instruction.
    pub language: Option<Vec<String>>,
    /// Rows of a chunk.
    pub horizon: Option<usize>,
    /// Whether a request needs the session's name.
    pub needs_session: Option<bool>,
    /// The kind of actions, as RoboArena names it.
    pub action_space: Option<String>,
}

/// An observation as a model gets it: one episode, named tensors.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ModelObservation {
    /// By key: `u8` of shape (frames, height, width, 3).
    pub images: Vec<(String, Tensor)>,
    /// By key: the numbers of one frame.
    pub states: Vec<(String, Vec<f32>)>,
    /// Key and words of the instruction.
    pub language: (String, String),
    /// Name of the session, for servers that keep a state.
    pub session: String,
    /// Rows that the answer is to have, for servers that are told.
    pub rows: usize,
}

/// An answer: a table of numbers for each key, all of the same number of rows.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ModelChunk {
    /// Rows.
    pub rows: usize,
    /// Key, width, and the numbers row by row.
    pub parts: Vec<(String, usize, Vec<f64>)>,
    /// The time that the server says it took, s.
    pub server_s: Option<f64>,
}

/// A model server, reconnected where that helps. After a time-out the connection is closed, and the next question opens
/// another one.
pub trait Model: Send {
    /// Asks what it is.
    ///
    /// # Errors
    /// [`BridgeError`]: nobody there, a time-out, or words that cannot be read.
    fn contract(&mut self) -> Result<Contract, BridgeError>;

    /// Asks for a chunk of actions.
    ///
    /// # Errors
    /// As [`Model::contract`]; [`BridgeError::Server`] where it refuses; numbers that are not finite.
    fn infer(&mut self, observation: &ModelObservation) -> Result<ModelChunk, BridgeError>;

    /// An episode begins: a server that keeps a state forgets it.
    ///
    /// # Errors
    /// As [`Model::contract`].
    fn reset(&mut self) -> Result<(), BridgeError>;
}

/// Where a model server is and how it is spoken to.
#[derive(Debug, Clone)]
pub struct ModelOptions {
    /// `tcp://HOST:PORT` of a GR00T server, `ws://HOST:PORT` of the others.
    pub url: String,
    /// How it speaks.
    pub dialect: Dialect,
    /// How long it is waited for.
    pub timeouts: Timeouts,
    /// Its API token or key, where it asks for one.
    pub token: Option<String>,
}

impl ModelOptions {
    /// A model server, to which nobody connects before the first question.
    ///
    /// # Errors
    /// [`BridgeError::Address`].
    pub fn model(&self) -> Result<Box<dyn Model>, BridgeError> {
        Ok(match self.dialect {
            Dialect::Gr00t | Dialect::Gr00tFlat | Dialect::Gr00tSonic => Box::new(gr00t::Gr00t::new(self)?),
            Dialect::Openpi | Dialect::Behavior | Dialect::Roboarena => Box::new(openpi::Openpi::new(self)?),
        })
    }
}

/// A table of an answer: (rows, width) or (1, rows, width), finite.
fn table(key: &str, tensor: &Tensor) -> Result<(String, usize, usize, Vec<f64>), BridgeError> {
    let what = || format!("the action '{key}'");
    let (rows, width) = match *tensor.shape() {
        [rows, width] | [1, rows, width] => (rows, width),
        [width] => (1, width),
        ref other => {
            return Err(BridgeError::malformed(what(), format!("its shape is {other:?}, not (rows, numbers)")));
        }
    };
    if rows == 0 || width == 0 {
        return Err(BridgeError::malformed(what(), "it is empty"));
    }
    let numbers = tensor.numbers();
    if let Some(at) = numbers.iter().position(|number| !number.is_finite()) {
        let (row, column) = (at / width, at % width);
        return Err(BridgeError::malformed(what(), format!("number {column} of row {row} is {}", numbers[at])));
    }
    Ok((key.into(), rows, width, numbers))
}

/// Puts tables together, which have to have the same number of rows.
fn chunk(tables: Vec<(String, usize, usize, Vec<f64>)>, server_s: Option<f64>) -> Result<ModelChunk, BridgeError> {
    let Some(&(_, rows, ..)) = tables.first() else {
        return Err(BridgeError::malformed("an answer", "it has no actions"));
    };
    if let Some((key, other, ..)) = tables.iter().find(|(_, other, ..)| *other != rows) {
        return Err(BridgeError::malformed("an answer", format!("'{key}' has {other} rows, others have {rows}")));
    }
    let parts = tables.into_iter().map(|(key, _, width, numbers)| (key, width, numbers)).collect();
    Ok(ModelChunk { rows, parts, server_s: server_s.filter(|time| time.is_finite() && *time >= 0.0) })
}
