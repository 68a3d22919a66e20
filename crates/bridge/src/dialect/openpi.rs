//! openpi over WebSocket, and its variants BEHAVIOR and RoboArena.

use rmpv::Value;

use super::tables::{chunk, table};
use super::{ActionTerms, Contract, Dialect, Model, ModelChunk, ModelObservation, ModelOptions};
use crate::net::{Address, Timeouts};
use crate::pack::{as_text, decode, described, encode, entry, text};
use crate::websocket::{Frame, Socket, shortened};
use crate::{BridgeError, Form, Tensor};

/// A server that speaks openpi or one of its two variants.
pub(super) struct Openpi {
    address: Address,
    timeouts: Timeouts,
    token: Option<String>,
    host: Option<String>,
    dialect: Dialect,
    link: Option<(Socket, Value)>,
}

impl Openpi {
    pub fn new(options: &ModelOptions) -> Result<Self, BridgeError> {
        Ok(Self {
            address: Address::parse(&options.url, "ws")?,
            timeouts: options.timeouts,
            token: options.token.clone(),
            host: options.host.clone(),
            dialect: options.dialect,
            link: None,
        })
    }

    /// Takes out the connection, and the metadata that the server sent when it opened. Callers put it back on success.
    fn take(&mut self) -> Result<(Socket, Value), BridgeError> {
        if let Some(link) = self.link.take() {
            return Ok(link);
        }
        let mut socket = Socket::connect(&self.address, self.timeouts, self.host.as_deref(), self.token.as_deref())?;
        let metadata = match socket.receive("metadata")? {
            Frame::Binary(bytes) => decode("the metadata", &bytes)?,
            Frame::Text(words) => {
                return Err(BridgeError::Server { question: "metadata".into(), text: shortened(&words) });
            }
        };
        if metadata.as_map().is_none() {
            return Err(BridgeError::malformed("the metadata", "it is not a map"));
        }
        Ok((socket, metadata))
    }

    /// The map of a request for a chunk of actions.
    fn question(&self, observation: &ModelObservation, metadata: &Value) -> Result<Value, BridgeError> {
        let mut entries = Vec::new();
        for (key, tensor) in &observation.images {
            // A single frame has no axis of frames.
            let tensor = match tensor.shape() {
                [1, rest @ ..] => Tensor::u8(rest.to_vec(), tensor.data().to_vec())?,
                _ => tensor.clone(),
            };
            entries.push((text(key), tensor.write(Form::Openpi)));
        }
        for (key, numbers) in &observation.states {
            entries.push((text(key), Tensor::f32(vec![numbers.len()], numbers)?.write(Form::Openpi)));
        }
        let (key, words) = &observation.language;
        if !key.is_empty() {
            entries.push((text(key), text(words)));
        }
        match self.dialect {
            Dialect::Behavior => {
                entries.push((text("__action_chunk_size__"), Value::from(observation.rows as u64)));
            }
            Dialect::Roboarena => {
                if entry(metadata, "needs_session_id").and_then(Value::as_bool) == Some(true) {
                    entries.push((text("session_id"), text(&observation.session)));
                }
                entries.push((text("endpoint"), text("infer")));
            }
            _ => {}
        }
        Ok(Value::Map(entries))
    }
}

impl Model for Openpi {
    fn contract(&mut self) -> Result<Contract, BridgeError> {
        let (socket, metadata) = self.take()?;
        let contract = contract(&metadata);
        self.link = Some((socket, metadata));
        Ok(contract)
    }

    fn infer(&mut self, observation: &ModelObservation) -> Result<ModelChunk, BridgeError> {
        let (mut socket, metadata) = self.take()?;
        socket.send("infer", encode(&self.question(observation, &metadata)?))?;
        let answer = match socket.receive("infer")? {
            Frame::Binary(bytes) => decode("an answer", &bytes)?,
            // A text frame is a traceback; the server closes after it.
            Frame::Text(words) => {
                return Err(BridgeError::Server { question: "infer".into(), text: shortened(&words) });
            }
        };
        let chunk = read(&answer, self.dialect, observation.rows)?;
        self.link = Some((socket, metadata));
        Ok(chunk)
    }

    fn reset(&mut self) -> Result<(), BridgeError> {
        match self.dialect {
            Dialect::Behavior => {
                let (mut socket, metadata) = self.take()?;
                // This dialect's reset gets no reply.
                socket.send("reset", encode(&Value::Map(vec![(text("reset"), Value::from(true))])))?;
                self.link = Some((socket, metadata));
            }
            Dialect::Roboarena => {
                let (mut socket, metadata) = self.take()?;
                socket.send("reset", encode(&Value::Map(vec![(text("endpoint"), text("reset"))])))?;
                match socket.receive("reset")? {
                    Frame::Text(words) if words.trim() == "reset successful" => {}
                    Frame::Text(words) => {
                        return Err(BridgeError::Server { question: "reset".into(), text: shortened(&words) });
                    }
                    Frame::Binary(_) => return Err(BridgeError::malformed("the reply to reset", "it is not text")),
                }
                self.link = Some((socket, metadata));
            }
            _ => {}
        }
        Ok(())
    }
}

pub(super) fn read(answer: &Value, dialect: Dialect, rows: usize) -> Result<ModelChunk, BridgeError> {
    // Relatives of openpi answer errors in a frame of their own, and wrap the answer.
    if let Some(error) = entry(answer, "error").filter(|error| !error.is_nil()) {
        let words = as_text(error).or_else(|| entry(error, "message").and_then(as_text));
        let text = shortened(words.unwrap_or("an error that is not text"));
        return Err(BridgeError::Server { question: "infer".into(), text });
    }
    let answer = entry(answer, "data").filter(|data| data.is_map()).unwrap_or(answer);
    let timing = entry(answer, "server_timing").and_then(|timing| entry(timing, "infer_ms")).and_then(Value::as_f64);
    let server_s = timing.map(|ms| ms / 1000.0);
    let keys: &[&str] = match dialect {
        Dialect::Behavior if rows > 1 => &["action_chunk"],
        Dialect::Behavior => &["action"],
        _ => &["actions", "action"],
    };
    let found = keys.iter().find_map(|key| entry(answer, key));
    let value = match dialect {
        Dialect::Roboarena => found.unwrap_or(answer),
        // A server of the challenge may answer one step at a time.
        _ if found.is_none() && dialect == Dialect::Behavior && entry(answer, "action").is_some() => {
            let problem = format!(
                "it has an 'action' and no 'action_chunk' of {rows} rows: the server answers one step at a time; in a copy of the \
                 mapping set horizon = 1 and prefix = 1 (--mapping FILE), or let the server answer chunks"
            );
            return Err(BridgeError::malformed("an answer", problem));
        }
        _ => found.ok_or_else(|| {
            let problem = format!("it has no '{}': {}", keys.join("' or '"), described(answer));
            BridgeError::malformed("an answer", problem)
        })?,
    };
    let name = if dialect == Dialect::Openpi { "actions" } else { "action" };
    let array = |value| Tensor::read(&format!("the action '{name}'"), value);
    let all = table(name, &array(value)?)?;
    if dialect == Dialect::Behavior && rows > 1 {
        let first = entry(answer, "action").ok_or_else(|| BridgeError::malformed("an answer", "it has no 'action'"))?;
        if array(first)?.numbers() != all.3[..all.2] {
            let problem = "its 'action' is not the first row of its 'action_chunk'";
            return Err(BridgeError::malformed("an answer", problem));
        }
    }
    chunk(vec![all], server_s)
}

/// Metadata has no fixed keys: reads those of RoboArena's config and of known openpi bridges.
fn contract(metadata: &Value) -> Contract {
    let number =
        |name: &str| entry(metadata, name).and_then(Value::as_u64).and_then(|number| usize::try_from(number).ok());
    let flag = |name: &str| entry(metadata, name).and_then(Value::as_bool);
    let size = entry(metadata, "image_resolution").and_then(Value::as_array).and_then(|sides| match sides.as_slice() {
        // Height comes first, as in NumPy.
        [height, width] => Some([u32::try_from(width.as_u64()?).ok()?, u32::try_from(height.as_u64()?).ok()?]),
        _ => None,
    });
    let cameras = number("n_external_cameras").map(|external| {
        let views = if flag("needs_stereo_camera") == Some(true) { 2 } else { 1 };
        external.saturating_mul(views).saturating_add(usize::from(flag("needs_wrist_camera") == Some(true)))
    });
    let width = number("action_dim");
    let keys = entry(metadata, "action_keys").and_then(Value::as_array);
    let terms = |key: &str| ActionTerms { key: key.into(), width, representation: None };
    let actions = match keys {
        Some(keys) => Some(keys.iter().filter_map(as_text).map(terms).collect()),
        None => width.map(|_| vec![terms("")]),
    };
    Contract {
        image_size: size,
        camera_count: cameras,
        horizon: number("action_horizon"),
        needs_session: flag("needs_session_id"),
        action_space: entry(metadata, "action_space").and_then(as_text).map(str::to_owned),
        actions,
        ..Contract::default()
    }
}
