//! Isaac GR00T: each request and each answer is one MessagePack map over ZeroMQ.

use rmpv::Value;

use super::{
    ActionTerms, CameraTerms, Contract, Dialect, Model, ModelChunk, ModelObservation, ModelOptions, chunk, table,
};
use crate::mapping::Representation;
use crate::net::{Address, Timeouts};
use crate::pack::{as_text, decode, encode, entry, map, text};
use crate::websocket::shortened;
use crate::zmq::Req;
use crate::{BridgeError, Tensor};

/// A GR00T server, connected by the first question.
pub(super) struct Gr00t {
    address: Address,
    timeouts: Timeouts,
    token: Option<String>,
    is_flat: bool,
    socket: Option<Req>,
}

impl Gr00t {
    pub fn new(options: &ModelOptions) -> Result<Self, BridgeError> {
        Ok(Self {
            address: Address::parse(&options.url, "tcp")?,
            timeouts: options.timeouts,
            token: options.token.clone(),
            is_flat: options.dialect == Dialect::Gr00tFlat,
            socket: None,
        })
    }

    /// Sends a request to an endpoint and reads the answer. Any failure closes the connection.
    fn ask(&mut self, endpoint: &str, data: Option<Value>) -> Result<Value, BridgeError> {
        let question = encode(&question(endpoint, data, self.token.as_deref()));
        let mut socket = match self.socket.take() {
            Some(socket) => socket,
            None => Req::connect(&self.address, self.timeouts)?,
        };
        let answer = socket.ask(endpoint, &question)?;
        self.socket = Some(socket);
        let refused = |words: &str| BridgeError::Server { question: endpoint.into(), text: shortened(words) };
        // Old servers give no reason.
        if answer == b"ERROR" {
            return Err(refused("ERROR without a reason; see its log"));
        }
        let answer = decode("an answer", &answer)?;
        match entry(&answer, "error") {
            Some(words) => Err(refused(as_text(words).unwrap_or("an error that is not text"))),
            None => Ok(answer),
        }
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
fn data(observation: &ModelObservation, is_flat: bool) -> Result<Value, BridgeError> {
    let image = |tensor: &Tensor| {
        let shape = [&[1], tensor.shape()].concat();
        Tensor::u8(shape, tensor.data().to_vec()).map(|tensor| tensor.to_gr00t())
    };
    let state = |numbers: &[f32]| Tensor::f32(vec![1, 1, numbers.len()], numbers).map(|tensor| tensor.to_gr00t());
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
        contract(&self.ask("get_modality_config", None)?)
    }

    fn infer(&mut self, observation: &ModelObservation) -> Result<ModelChunk, BridgeError> {
        let answer = self.ask("get_action", Some(data(observation, self.is_flat)?))?;
        let wrong = |problem: &str| BridgeError::malformed("an answer", problem);
        let actions = match &answer {
            Value::Array(parts) => parts.first().ok_or_else(|| wrong("it is an empty array"))?,
            _ => return Err(wrong("it is not an array of actions and info")),
        };
        let actions = actions.as_map().ok_or_else(|| wrong("its actions are not a map"))?;
        let read = |(key, value): &(Value, Value)| {
            let key = as_text(key).ok_or_else(|| wrong("a key of its actions is not text"))?;
            let tensor = Tensor::of_gr00t(value).ok_or_else(|| wrong(&format!("'{key}' is not an array")))??;
            // Batch, rows, numbers: only a fault of the server's wrapper loses the batch.
            if tensor.shape().len() != 3 {
                let problem = format!("its shape is {:?}, not (1, rows, numbers)", tensor.shape());
                return Err(BridgeError::malformed(format!("the action '{key}'"), problem));
            }
            table(key.strip_prefix("action.").unwrap_or(key), &tensor)
        };
        chunk(actions.iter().map(read).collect::<Result<_, _>>()?, None)
    }

    fn reset(&mut self) -> Result<(), BridgeError> {
        self.ask("reset", Some(map([("options", Value::Nil)]))).map(drop)
    }
}

/// Reads the modality config in either of the two forms that servers send.
fn contract(answer: &Value) -> Result<Contract, BridgeError> {
    let wrong = |problem: String| BridgeError::malformed("the modality config", problem);
    let modality = |name: &str| -> Result<Option<Value>, BridgeError> {
        let Some(value) = entry(answer, name) else { return Ok(None) };
        let config = match (entry(value, "as_dict"), entry(value, "as_json").and_then(as_text)) {
            (Some(config), _) => config.clone(),
            (None, Some(json)) => json_value(json).ok_or_else(|| wrong(format!("'{name}' is not JSON")))?,
            (None, None) => value.clone(),
        };
        if config.as_map().is_none() {
            return Err(wrong(format!("'{name}' is not a map")));
        }
        Ok(Some(config))
    };
    let keys = |config: &Value| -> Vec<String> {
        let keys = entry(config, "modality_keys").and_then(Value::as_array).map(Vec::as_slice).unwrap_or_default();
        keys.iter().filter_map(|key| as_text(key).map(str::to_owned)).collect()
    };
    let deltas = |config: &Value| -> Option<Vec<i64>> {
        let deltas = entry(config, "delta_indices").and_then(Value::as_array)?;
        Some(deltas.iter().filter_map(Value::as_i64).collect())
    };
    let plain = |key: String, group: &str| key.strip_prefix(&format!("{group}.")).map(str::to_owned).unwrap_or(key);
    let mut contract = Contract::default();
    if let Some(video) = modality("video")? {
        let camera = |key| CameraTerms { key: plain(key, "video"), size: None, delta: deltas(&video) };
        contract.cameras = Some(keys(&video).into_iter().map(camera).collect());
    }
    if let Some(state) = modality("state")? {
        contract.states = Some(keys(&state).into_iter().map(|key| (plain(key, "state"), None)).collect());
        contract.state_frames = deltas(&state).map(|deltas| deltas.len());
    }
    if let Some(action) = modality("action")? {
        let configs = entry(&action, "action_configs").and_then(Value::as_array);
        let terms = |(at, key)| ActionTerms {
            key: plain(key, "action"),
            width: None,
            representation: configs
                .and_then(|configs| configs.get(at))
                .and_then(|config| entry(config, "rep").and_then(as_text))
                .and_then(Representation::by_name),
        };
        contract.actions = Some(keys(&action).into_iter().enumerate().map(terms).collect());
        contract.horizon = deltas(&action).map(|deltas| deltas.len());
    }
    contract.language = modality("language")?.map(|language| keys(&language));
    if contract.actions.is_none() {
        return Err(wrong("it has no 'action'; is the server of this dialect?".into()));
    }
    Ok(contract)
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
        let ours = data(&observation, false).unwrap();
        let golden = decode("it", &hex(GET_ACTION)).unwrap();
        let golden = entry(entry(&golden, "data").unwrap(), "observation").unwrap();
        let ours = entry(&ours, "observation").unwrap();
        assert_eq!(entry(ours, "state"), entry(golden, "state"));
        assert_eq!(encode(&question("ping", None, None)), hex("81a8656e64706f696e74a470696e67"));
    }

    #[test]
    fn modality_configs_are_read_in_both_forms() {
        let config = |keys: &[&str], deltas: &[i64]| {
            let keys = keys.iter().map(|key| text(key)).collect();
            let deltas = deltas.iter().map(|delta| Value::from(*delta)).collect();
            map([("delta_indices", Value::Array(deltas)), ("modality_keys", Value::Array(keys))])
        };
        let class = |form: &str, config: Value| map([("__ModalityConfig_class__", Value::from(true)), (form, config)]);
        let rep = r#"{"delta_indices": [0, 1], "modality_keys": ["waist"], "action_configs": [{"rep": "RELATIVE"}]}"#;
        let answer = map([
            ("video", class("as_dict", config(&["ego_view"], &[-20, 0]))),
            ("state", class("as_dict", config(&["waist"], &[0]))),
            ("action", class("as_json", text(rep))),
            ("language", class("as_dict", config(&["task"], &[0]))),
        ]);
        let read = contract(&answer).unwrap();
        assert_eq!(read.cameras.unwrap()[0].delta, Some(vec![-20, 0]));
        let action = &read.actions.unwrap()[0];
        assert_eq!((action.representation, read.horizon), (Some(Representation::Relative), Some(2)));
        assert!(contract(&Value::from(3)).is_err());
        assert!(contract(&map([("action", text("x"))])).is_err());
    }
}
