//! openpi over WebSocket, and its variants BEHAVIOR and RoboArena.

use rmpv::Value;

use super::{ActionTerms, Contract, Dialect, Model, ModelChunk, ModelObservation, ModelOptions, chunk, table};
use crate::net::{Address, Timeouts};
use crate::pack::{as_text, decode, encode, entry, text};
use crate::websocket::{Frame, Socket, shortened};
use crate::{BridgeError, Tensor};

/// A server that speaks openpi or one of its two variants.
pub(super) struct Openpi {
    address: Address,
    timeouts: Timeouts,
    token: Option<String>,
    dialect: Dialect,
    link: Option<(Socket, Value)>,
}

impl Openpi {
    pub fn new(options: &ModelOptions) -> Result<Self, BridgeError> {
        Ok(Self {
            address: Address::parse(&options.url, "ws")?,
            timeouts: options.timeouts,
            token: options.token.clone(),
            dialect: options.dialect,
            link: None,
        })
    }

    /// Takes out the connection, and the metadata that the server sent when it opened. Callers put it back on success.
    fn take(&mut self) -> Result<(Socket, Value), BridgeError> {
        if let Some(link) = self.link.take() {
            return Ok(link);
        }
        let mut socket = Socket::connect(&self.address, self.timeouts, self.token.as_deref())?;
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
            entries.push((text(key), tensor.to_openpi()));
        }
        for (key, numbers) in &observation.states {
            entries.push((text(key), Tensor::f32(vec![numbers.len()], numbers)?.to_openpi()));
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
        self.link = Some((socket, metadata));
        read(&answer, self.dialect, observation.rows)
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

/// Reads the actions of an answer.
fn read(answer: &Value, dialect: Dialect, rows: usize) -> Result<ModelChunk, BridgeError> {
    let wrong = |problem: String| BridgeError::malformed("an answer", problem);
    let tensor = |value: &Value, key: &str| {
        Tensor::of_openpi(value).ok_or_else(|| wrong(format!("'{key}' is not an array"))).flatten()
    };
    let timing = entry(answer, "server_timing").and_then(|timing| entry(timing, "infer_ms")).and_then(Value::as_f64);
    let server_s = timing.map(|ms| ms / 1000.0);
    let key = match dialect {
        Dialect::Roboarena => return chunk(vec![table("action", &tensor(answer, "action")?)?], server_s),
        Dialect::Behavior if rows > 1 => "action_chunk",
        Dialect::Behavior => "action",
        _ => "actions",
    };
    let value = entry(answer, key).ok_or_else(|| wrong(format!("it has no '{key}'")))?;
    let all = table("action", &tensor(value, key)?)?;
    if dialect == Dialect::Behavior && rows > 1 {
        let first = entry(answer, "action").ok_or_else(|| wrong("it has no 'action'".into()))?;
        let first = tensor(first, "action")?.numbers();
        if first != all.3[..all.2] {
            return Err(wrong("its 'action' is not the first row of its 'action_chunk'".into()));
        }
    }
    let (_, rows, width, numbers) = all;
    let name = if dialect == Dialect::Openpi { "actions" } else { "action" };
    chunk(vec![(name.into(), rows, width, numbers)], server_s)
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
