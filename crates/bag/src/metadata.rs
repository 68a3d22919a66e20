//! Header and result as metadata records: a field each, strings as they are, anything else as JSON.

use std::collections::BTreeMap;

use fiatlux_proto::v3::Version;
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Map, Value};

pub(crate) const HEADER: &str = "fiatlux";
pub(crate) const RESULT: &str = "fiatlux.result";
/// Name of the record of a bag that could not be completed.
pub(crate) const CUT: &str = "fiatlux.cut";
/// Name of the record of a thin bag.
pub(crate) const THIN: &str = "fiatlux.thin";

type Fields = BTreeMap<String, String>;

/// The fields of a message; `None` where they would not read back as they are.
pub(crate) fn fields<M>(message: &M) -> Option<Fields>
where
    M: Serialize + DeserializeOwned + Default + PartialEq,
{
    let Value::Object(object) = serde_json::to_value(message).ok()? else { return None };
    let text = |value| match value {
        Value::String(text) => text,
        other => other.to_string(),
    };
    let fields = object.into_iter().map(|(name, value)| (name, text(value))).collect();
    (message_of::<M>(&fields).as_ref() == Ok(message)).then_some(fields)
}

/// The protocol version in a header, even if its other fields cannot be read.
pub(crate) fn protocol(fields: &Fields) -> Option<Version> {
    serde_json::from_str(fields.get("protocol")?).ok()
}

/// The message with these fields. Entries without a field are ignored.
pub(crate) fn message_of<M>(fields: &Fields) -> Result<M, String>
where
    M: Serialize + DeserializeOwned + Default,
{
    let mut object = Map::new();
    for (name, default) in known::<M>() {
        let Some(text) = fields.get(&name) else { continue };
        let value = match default {
            Value::String(_) => Value::String(text.clone()),
            _ => serde_json::from_str(text).map_err(|error| format!("{name}: {error}"))?,
        };
        object.insert(name, value);
    }
    serde_json::from_value(Value::Object(object)).map_err(|error| error.to_string())
}

/// The first field that the message does not define.
pub(crate) fn unknown_field<M: Serialize + Default>(fields: &Fields) -> Option<String> {
    let known = known::<M>();
    fields.keys().find(|name| !known.contains_key(*name)).cloned()
}

/// The fields of a message, with their defaults.
fn known<M: Serialize + Default>() -> Map<String, Value> {
    match serde_json::to_value(M::default()) {
        Ok(Value::Object(known)) => known,
        _ => Map::new(),
    }
}

#[cfg(test)]
mod tests {
    use fiatlux_proto::v3::{EpisodeHeader, EpisodeResult, OpenRequest, PropScale, Randomization, Sensor, Version};

    use super::*;

    #[test]
    fn a_header_reads_back_to_the_last_bit() {
        let thresholds = [0.1 + 0.2, 1e300, f64::MIN_POSITIVE, 2.225_073_858_507_201e-308, -0.0, 50.0];
        let header = EpisodeHeader {
            protocol: Some(Version { major: 2, minor: 7 }),
            instruction: "say \"yes\",\nthen 12".into(),
            // Strings that look like other JSON stay strings.
            policy: "null".into(),
            gains: "12".into(),
            seed: u64::MAX,
            thresholds: thresholds.iter().enumerate().map(|(i, t)| (format!("t{i}"), *t)).collect(),
            joint_names: vec!["a".into(), "b".into()],
            randomization: Some(Randomization { fixed_start: true, ..Randomization::default() }),
            request: Some(OpenRequest {
                prop_scale: Some(PropScale { socket: 0.1 + 0.2, ..PropScale::default() }),
                ..OpenRequest::default()
            }),
            sensors: vec![Sensor { name: "lidar".into(), rate_hz: 12.5, ..Sensor::default() }],
            control_dt: 0.02,
            ..EpisodeHeader::default()
        };
        let fields = fields(&header).expect("a header with finite numbers");
        assert_eq!(fields["policy"], "null");
        assert_eq!(fields["seed"], u64::MAX.to_string());
        let read: EpisodeHeader = message_of(&fields).expect("reads back");
        assert_eq!(read, header);
        for (name, value) in &header.thresholds {
            assert_eq!(read.thresholds[name].to_bits(), value.to_bits(), "{name}");
        }
    }

    #[test]
    fn what_cannot_read_back_is_refused() {
        assert_eq!(fields(&EpisodeResult { total_reward: f64::NAN, ..EpisodeResult::default() }), None);
        let fields = BTreeMap::from([("seed".to_owned(), "x".to_owned())]);
        assert!(message_of::<EpisodeHeader>(&fields).is_err());
    }
}
