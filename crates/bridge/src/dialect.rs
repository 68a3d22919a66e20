//! Requests to a model server and its answers, in the same form for every dialect.

mod gr00t;
mod openpi;
mod tables;

use std::str::FromStr;

use crate::net::Timeouts;
use crate::representation::Representation;
use crate::{BridgeError, Tensor};

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Dialect {
    /// Isaac GR00T N1.6 and N1.7: ZeroMQ, nested keys.
    Gr00t,
    /// GR00T with the server's flag `--use-sim-policy-wrapper`: flat keys.
    Gr00tFlat,
    /// GR00T with a model that outputs motion tokens of GEAR-SONIC.
    Gr00tSonic,
    /// openpi: MessagePack over WebSocket.
    Openpi,
    /// openpi in the form of the BEHAVIOR challenge: a reset without a reply, chunks on request.
    Behavior,
    /// openpi in the form of RoboArena: the server sends its config first, requests name an endpoint, answers are bare
    /// arrays.
    Roboarena,
}

impl Dialect {
    /// Every dialect with its name on the command line.
    pub const ALL: [(&'static str, Self); 6] = [
        ("gr00t", Self::Gr00t),
        ("gr00t-flat", Self::Gr00tFlat),
        ("gr00t-sonic", Self::Gr00tSonic),
        ("openpi", Self::Openpi),
        ("behavior", Self::Behavior),
        ("roboarena", Self::Roboarena),
    ];

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

#[derive(Debug, Clone, PartialEq, Default)]
pub struct CameraTerms {
    pub key: String,
    /// Width and height, pixels; `None` if the server does not say.
    pub size: Option<[u32; 2]>,
    /// Frames that the server wants, in rows relative to the present: 0 for the current one. `None` if it does not say.
    pub delta: Option<Vec<i64>>,
}

#[derive(Debug, Clone, PartialEq, Default)]
pub struct ActionTerms {
    /// Name of the key; empty if the server has a single key without a name.
    pub key: String,
    /// Numbers in a row; `None` if the server does not say.
    pub width: Option<usize>,
    /// `None` if the server does not say.
    pub representation: Option<Representation>,
}

/// The terms that a server announces. A field that it leaves out is [`None`] and cannot be compared before the first
/// answer.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Contract {
    pub cameras: Option<Vec<CameraTerms>>,
    /// Number of cameras that it wants, if it does not name them.
    pub camera_count: Option<usize>,
    pub image_size: Option<[u32; 2]>,
    /// Keys of the state, each with its number of values if the server says so.
    pub states: Option<Vec<(String, Option<usize>)>>,
    pub state_frames: Option<usize>,
    pub actions: Option<Vec<ActionTerms>>,
    /// Keys under which it reads the instruction.
    pub language: Option<Vec<String>>,
    pub horizon: Option<usize>,
    /// Requests must carry the session's name.
    pub needs_session: Option<bool>,
    /// Kind of actions, in RoboArena's words.
    pub action_space: Option<String>,
}

/// An observation for a model: one episode, named tensors.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ModelObservation {
    /// Key and pictures: `u8` of shape (frames, height, width, 3).
    pub images: Vec<(String, Tensor)>,
    /// Key and numbers of a single frame.
    pub states: Vec<(String, Vec<f32>)>,
    pub language: (String, String),
    /// Name of the session, for servers that keep state between requests.
    pub session: String,
    /// Number of rows that the answer should have, for dialects in which the client decides.
    pub rows: usize,
}

/// An answer: one table of numbers for each key, all with the same number of rows.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ModelChunk {
    pub rows: usize,
    pub parts: Vec<(String, usize, Vec<f64>)>,
    /// Inference time as reported by the server, s.
    pub server_s: Option<f64>,
}

/// A connection to a model server. After a time-out it is closed, and the next request opens a new one.
pub trait Model: Send {
    /// Asks the server for its contract.
    ///
    /// # Errors
    /// [`BridgeError`]: nobody answers, a time-out, or an answer that cannot be decoded.
    fn contract(&mut self) -> Result<Contract, BridgeError>;

    /// Requests a chunk of actions.
    ///
    /// # Errors
    /// As [`Model::contract`]; [`BridgeError::Server`] if it refuses; [`BridgeError::Malformed`] for numbers that are
    /// not finite.
    fn infer(&mut self, observation: &ModelObservation) -> Result<ModelChunk, BridgeError>;

    /// Tells the server that an episode begins, so that it forgets any state.
    fn reset(&mut self) -> Result<(), BridgeError>;
}

#[derive(Debug, Clone)]
pub struct ModelOptions {
    /// `tcp://HOST:PORT` of a GR00T server, `ws://HOST:PORT/PATH` of the others.
    pub url: String,
    /// Name of a WebSocket server behind a tunnel or proxy, sent as the header `Host`; `None` for that of `url`.
    pub host: Option<String>,
    pub dialect: Dialect,
    pub timeouts: Timeouts,
    /// API token or key; `None` if the server needs none.
    pub token: Option<String>,
}

impl ModelOptions {
    /// Prepares a connection; the first request opens it.
    pub fn model(&self) -> Result<Box<dyn Model>, BridgeError> {
        Ok(match self.dialect {
            Dialect::Gr00t | Dialect::Gr00tFlat | Dialect::Gr00tSonic => Box::new(gr00t::Gr00t::new(self)?),
            Dialect::Openpi | Dialect::Behavior | Dialect::Roboarena => Box::new(openpi::Openpi::new(self)?),
        })
    }
}

#[cfg(test)]
mod tests;
