//! Isaac GR00T: each request and each answer is one MessagePack map over ZeroMQ.

use rmpv::Value;

use super::tables::{chunk, table};
use super::{ActionTerms, CameraTerms, Contract, Dialect, Model, ModelChunk, ModelObservation, ModelOptions};
use crate::net::{Address, Timeouts};
use crate::pack::{as_text, decode, described, encode, entry, map, text};
use crate::representation::Representation;
use crate::websocket::shortened;
use crate::zmq::Req;
use crate::{BridgeError, Form, Tensor};

/// A GR00T server, connected by the first request.
pub(super) struct Gr00t {
    address: Address,
    timeouts: Timeouts,
    token: Option<String>,
    is_flat: bool,
    form: Form,
    /// The server has answered a request with arrays in `form`.
    is_form_known: bool,
    socket: Option<Req>,
}

impl Gr00t {
    pub fn new(options: &ModelOptions) -> Result<Self, BridgeError> {
        Ok(Self {
            address: Address::parse(&options.url, "tcp")?,
            timeouts: options.timeouts,
            token: options.token.clone(),
            is_flat: options.dialect == Dialect::Gr00tFlat,
            form: Form::Npy,
            is_form_known: false,
            socket: None,
        })
    }

    /// Sends a request to an endpoint and reads the answer by `read`. Any failure closes the connection.
    fn ask<T>(
        &mut self,
        endpoint: &str,
        data: Option<Value>,
        read: impl Fn(&Value) -> Result<T, BridgeError>,
    ) -> Result<T, BridgeError> {
        let question = encode(&question(endpoint, data, self.token.as_deref()));
        let mut socket = match self.socket.take() {
            Some(socket) => socket,
            None => Req::connect(&self.address, self.timeouts)?,
        };
        let answer = socket.ask(endpoint, &question)?;
        let refused = |words: &str| BridgeError::Server { question: endpoint.into(), text: shortened(words) };
        // Old servers give no reason.
        if answer == b"ERROR" {
            return Err(refused("ERROR without a reason; see its log"));
        }
        let answer = decode("an answer", &answer)?;
        if let Some(words) = entry(&answer, "error") {
            return Err(refused(as_text(words).unwrap_or("an error that is not text")));
        }
        let read = read(&answer)?;
        self.socket = Some(socket);
        Ok(read)
    }

    fn ask_chunk(&mut self, observation: &ModelObservation) -> Result<ModelChunk, BridgeError> {
        let data = data(observation, self.is_flat, self.form)?;
        let chunk = self.ask("get_action", Some(data), chunk_of)?;
        self.is_form_known = true;
        Ok(chunk)
    }
}

/// A request in the same bytes that GR00T's client would send.
fn question(endpoint: &str, data: Option<Value>, token: Option<&str>) -> Value {
    let mut question = vec![(text("endpoint"), text(endpoint))];
    question.extend(data.map(|data| (text("data"), data)));
    question.extend(token.map(|token| (text("api_token"), text(token))));
    Value::Map(question)
}

/// The `data` field of a `get_action` request.
fn data(observation: &ModelObservation, is_flat: bool, form: Form) -> Result<Value, BridgeError> {
    let image = |tensor: &Tensor| {
        let shape = [&[1], tensor.shape()].concat();
        Tensor::u8(shape, tensor.data().to_vec()).map(|tensor| tensor.write(form))
    };
    let state = |numbers: &[f32]| Tensor::f32(vec![1, 1, numbers.len()], numbers).map(|tensor| tensor.write(form));
    let images: Vec<(&str, Value)> = observation
        .images
        .iter()
        .map(|(key, tensor)| Ok((key.as_str(), image(tensor)?)))
        .collect::<Result<_, BridgeError>>()?;
    let states: Vec<(&str, Value)> = observation
        .states
        .iter()
        .map(|(key, numbers)| Ok((key.as_str(), state(numbers)?)))
        .collect::<Result<_, BridgeError>>()?;
    let (key, words) = &observation.language;
    let observation = if is_flat {
        let images = images.into_iter().map(|(key, value)| (text(&format!("video.{key}")), value));
        let states = states.into_iter().map(|(key, value)| (text(&format!("state.{key}")), value));
        let language = (text(key), Value::Array(vec![text(words)]));
        Value::Map(images.chain(states).chain([language]).collect())
    } else {
        let group = |entries: Vec<(&str, Value)>| {
            Value::Map(entries.into_iter().map(|(key, value)| (text(key), value)).collect())
        };
        let words = Value::Array(vec![Value::Array(vec![text(words)])]);
        map([("video", group(images)), ("state", group(states)), ("language", group(vec![(key, words)]))])
    };
    Ok(map([("observation", observation), ("options", Value::Nil)]))
}

impl Model for Gr00t {
    fn contract(&mut self) -> Result<Contract, BridgeError> {
        self.ask("get_modality_config", None, contract)
    }

    /// Some servers of N1.7 read only the arrays of `msgpack-numpy`, older ones only `.npy` files. So a refused first
    /// request is sent again in the other form.
    fn infer(&mut self, observation: &ModelObservation) -> Result<ModelChunk, BridgeError> {
        let refused = match self.ask_chunk(observation) {
            Err(refused @ BridgeError::Server { .. }) if !self.is_form_known => refused,
            other => return other,
        };
        self.form = Form::MsgpackNumpy;
        self.ask_chunk(observation).map_err(|_| {
            self.form = Form::Npy;
            refused
        })
    }

    fn reset(&mut self) -> Result<(), BridgeError> {
        self.ask("reset", Some(map([("options", Value::Nil)])), |_| Ok(()))
    }
}

/// Reads the actions of an answer: first of a list of actions and info, or of a map without info (N1.5).
pub(super) fn chunk_of(answer: &Value) -> Result<ModelChunk, BridgeError> {
    let wrong = |problem: String| BridgeError::malformed("an answer", problem);
    let actions = match answer {
        Value::Array(parts) => parts.first().ok_or_else(|| wrong("it is an empty list".into()))?,
        _ => answer,
    };
    let entries = actions.as_map();
    let entries = entries.ok_or_else(|| wrong(format!("its actions are {}, not a map", described(actions))))?;
    let read = |(key, value): &(Value, Value)| {
        let key = as_text(key).ok_or_else(|| wrong("a key of its actions is not text".into()))?;
        let what = format!("the action '{key}'");
        let tensor = Tensor::read(&what, value)?;
        // N1.5 has no axis of the batch. Fewer axes would leave open which numbers are rows.
        if !(2..=3).contains(&tensor.shape().len()) {
            let problem = format!("its shape is {:?}, not (1, rows, numbers) or (rows, numbers)", tensor.shape());
            return Err(BridgeError::malformed(what, problem));
        }
        table(key.strip_prefix("action.").unwrap_or(key), &tensor)
    };
    chunk(entries.iter().map(read).collect::<Result<_, _>>()?, None)
}

/// Reads the modality config in every form that servers send: plain maps, and maps with the config as a map or as JSON.
pub(super) fn contract(answer: &Value) -> Result<Contract, BridgeError> {
    let mut contract = Contract::default();
    if let Some(video) = Modality::read(answer, "video")? {
        let camera = |key| CameraTerms { key, size: None, delta: video.deltas.clone() };
        contract.cameras = Some(video.keys.into_iter().map(camera).collect());
    }
    if let Some(state) = Modality::read(answer, "state")? {
        contract.states = Some(state.keys.into_iter().map(|key| (key, None)).collect());
        contract.state_frames = state.deltas.map(|deltas| deltas.len());
    }
    let action = Modality::read(answer, "action")?.ok_or_else(|| {
        let problem = format!("it has no 'action': {}; check that the server speaks this dialect", described(answer));
        BridgeError::malformed("the modality config", problem)
    })?;
    let terms = |(at, key): (usize, String)| ActionTerms {
        key,
        width: None,
        representation: action.representations.get(at).copied().flatten(),
    };
    contract.actions = Some(action.keys.into_iter().enumerate().map(terms).collect());
    contract.horizon = action.deltas.map(|deltas| deltas.len());
    contract.language = Modality::read(answer, "language")?.map(|language| language.keys);
    Ok(contract)
}

/// The config of video, state, action or language.
struct Modality {
    /// Without the modality's prefix.
    keys: Vec<String>,
    /// Rows relative to the present; `None` if the server does not say.
    deltas: Option<Vec<i64>>,
    /// Meaning of each action key's numbers; `None` if the server does not say.
    representations: Vec<Option<Representation>>,
}

impl Modality {
    /// Reads one modality of a modality config; `None` if the config does not have it.
    fn read(answer: &Value, name: &str) -> Result<Option<Self>, BridgeError> {
        let Some(value) = entry(answer, name) else { return Ok(None) };
        let what = format!("the modality config '{name}'");
        let wrong = |problem: String| BridgeError::malformed(&what, problem);
        let config = ["as_json", "as_dict", "fields"].iter().find_map(|form| entry(value, form)).unwrap_or(value);
        let config = match as_text(config) {
            Some(json) => json_value(json).ok_or_else(|| wrong("it is text, but not JSON".into()))?,
            None => config.clone(),
        };
        let list = |field: &str| entry(&config, field).and_then(Value::as_array).map(Vec::as_slice);
        let keys = list("modality_keys").ok_or_else(|| {
            wrong(format!("it has no list 'modality_keys': {}, with {}", described(value), described(&config)))
        })?;
        let prefix = format!("{name}.");
        let key = |key: &Value| -> Result<String, BridgeError> {
            let key = as_text(key).ok_or_else(|| wrong(format!("a key is {}, not text", described(key))))?;
            let is_language = name == "language";
            Ok(if is_language { key } else { key.strip_prefix(&prefix).unwrap_or(key) }.to_owned())
        };
        let deltas = entry(&config, "delta_indices").filter(|deltas| !deltas.is_nil());
        let deltas = deltas.map(|deltas| Tensor::read(&format!("{what}, 'delta_indices'"), deltas)).transpose()?;
        let representation = |config: &Value| {
            let word = entry(config, "rep")?;
            as_text(entry(word, "value").unwrap_or(word)).and_then(Representation::by_name)
        };
        Ok(Some(Self {
            keys: keys.iter().map(key).collect::<Result<_, _>>()?,
            deltas: deltas.map(|deltas| deltas.numbers().iter().map(|delta| *delta as i64).collect()),
            representations: list("action_configs").unwrap_or_default().iter().map(representation).collect(),
        }))
    }
}

/// Converts JSON to a MessagePack value; `None` if it is not JSON.
fn json_value(json: &str) -> Option<Value> {
    fn value(json: &serde_json::Value) -> Value {
        match json {
            serde_json::Value::Null => Value::Nil,
            serde_json::Value::Bool(flag) => Value::from(*flag),
            serde_json::Value::Number(number) => match number.as_i64() {
                Some(whole) => Value::from(whole),
                None => Value::from(number.as_f64().unwrap_or(f64::NAN)),
            },
            serde_json::Value::String(words) => text(words),
            serde_json::Value::Array(values) => Value::Array(values.iter().map(value).collect()),
            serde_json::Value::Object(entries) => {
                Value::Map(entries.iter().map(|(key, entry)| (text(key), value(entry))).collect())
            }
        }
    }
    serde_json::from_str(json).ok().as_ref().map(value)
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::tensor::tests::{GET_ACTION, hex};

    /// The golden request has only a state; ours has video and language too, so the parts are compared.
    #[test]
    fn requests_have_the_golden_shape() {
        let observation = ModelObservation {
            states: vec![("waist".into(), vec![1.0, 2.0])],
            language: ("task".into(), "go".into()),
            ..ModelObservation::default()
        };
        let ours = data(&observation, false, Form::Npy).unwrap();
        let golden = decode("it", &hex(GET_ACTION)).unwrap();
        let golden = entry(entry(&golden, "data").unwrap(), "observation").unwrap();
        let ours = entry(&ours, "observation").unwrap();
        assert_eq!(entry(ours, "state"), entry(golden, "state"));
        assert_eq!(encode(&question("ping", None, None)), hex("81a8656e64706f696e74a470696e67"));
    }
}
