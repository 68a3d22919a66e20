#![allow(clippy::unwrap_used)]

use rmpv::Value;
use serde_json::Value as Json;

use super::*;
use crate::pack::{decode, map, text};
use crate::tensor::tests::hex;

/// Messages of real packages, written by `tests/bridge/golden.py`; its first lines name their versions.
const GOLDEN: &str = include_str!("golden.jsonl");

/// The golden messages of a kind, each with its name and decoded.
fn golden(kind: &str) -> Vec<(String, Json, Value)> {
    let lines = GOLDEN.lines().map(|line| serde_json::from_str::<Json>(line).unwrap());
    let of_kind = lines.filter(|line| line["kind"] == kind);
    let read = |line: Json| {
        let value = decode("it", &hex(line["hex"].as_str().unwrap())).unwrap();
        (line["name"].as_str().unwrap().to_owned(), line, value)
    };
    of_kind.map(read).collect()
}

#[test]
fn arrays_of_real_packages_are_read() {
    let arrays = golden("array");
    assert_eq!(arrays.len(), 81);
    for (name, line, value) in arrays {
        let tensor = Tensor::read("it", &value).unwrap_or_else(|error| panic!("{name}: {error}"));
        let numbers: Vec<f64> = serde_json::from_value(line["numbers"].clone()).unwrap();
        let shape: Vec<usize> = serde_json::from_value(line["shape"].clone()).unwrap();
        assert_eq!((tensor.shape(), tensor.numbers()), (shape.as_slice(), numbers), "{name}");
    }
}

#[test]
fn contracts_of_all_servers_are_read() {
    let contracts = golden("contract");
    assert_eq!(contracts.len(), 11);
    for (name, _, value) in contracts {
        let read = gr00t::contract(&value).unwrap_or_else(|error| panic!("{name}: {error}"));
        let cameras = [CameraTerms { key: "ego_view".into(), size: None, delta: Some(vec![-20, 0]) }];
        assert_eq!(read.cameras.as_deref(), Some(&cameras[..]), "{name}");
        assert_eq!((read.states, read.state_frames), (Some(vec![("waist".into(), None)]), Some(1)), "{name}");
        assert_eq!(read.language, Some(vec!["annotation.human.task_description".into()]), "{name}");
        assert_eq!(read.horizon, Some(3), "{name}");
        let says = !name.starts_with("N1.5");
        let term = |key: &str, representation| ActionTerms {
            key: key.into(),
            width: None,
            representation: Some(representation).filter(|_| says),
        };
        let terms = [term("left_arm", Representation::Relative), term("waist", Representation::Absolute)];
        assert_eq!(read.actions.as_deref(), Some(&terms[..]), "{name}");
    }
}

#[test]
fn chunks_of_all_servers_are_read() {
    let chunks = golden("chunk");
    assert_eq!(chunks.len(), 20);
    for (name, line, value) in chunks {
        let dialect: Dialect = line["dialect"].as_str().unwrap().parse().unwrap();
        let (read, key) = match dialect {
            Dialect::Gr00t | Dialect::Gr00tFlat | Dialect::Gr00tSonic => (gr00t::chunk_of(&value), "left_arm"),
            Dialect::Openpi => (openpi::read(&value, dialect, 3), "actions"),
            Dialect::Behavior | Dialect::Roboarena => (openpi::read(&value, dialect, 3), "action"),
        };
        let read = read.unwrap_or_else(|error| panic!("{dialect:?}, {name}: {error}"));
        let part = (key.to_owned(), 2, vec![-1.0, 0.0, 1.0, 2.0, 3.0, 4.0]);
        assert_eq!((read.rows, read.parts), (3, vec![part]), "{dialect:?}, {name}");
    }
}

/// Guards that a server of the challenge which answers one step at a time is told apart, and what its user is to do.
#[test]
fn one_action_in_place_of_a_chunk_has_a_remedy() {
    let row = Value::Array(vec![Value::F64(0.5), Value::F64(-0.5)]);
    let answer = map([("action", row)]);
    let said = openpi::read(&answer, Dialect::Behavior, 3).unwrap_err().to_string();
    let remedy = "no 'action_chunk' of 3 rows: the server answers one step at a time; in a copy of the mapping set horizon = 1 and \
                  prefix = 1 (--mapping FILE), or let the server answer chunks";
    assert!(said.contains(remedy), "{said}");
    // What the remedy says: the same answer to a mapping of one row.
    let read = openpi::read(&answer, Dialect::Behavior, 1).unwrap();
    assert_eq!((read.rows, read.parts), (1, vec![("action".into(), 2, vec![0.5, -0.5])]));
    let neither = openpi::read(&map([("actions", Value::Nil)]), Dialect::Behavior, 3).unwrap_err().to_string();
    assert!(neither.contains("it has no 'action_chunk'") && !neither.contains("one step at a time"), "{neither}");
}

/// Guards that an error describes a form that cannot be read.
#[test]
fn the_form_is_in_the_error() {
    let one = |value: Value| Value::Array(vec![map([("left_arm", value)]), map([])]);
    let nd = |dtype: &str, kind: &str| {
        map([
            ("nd", true.into()),
            ("type", text(dtype)),
            ("kind", text(kind)),
            ("shape", Value::Array(vec![])),
            ("data", text("")),
        ])
    };
    for (value, says) in [
        (one(map([("__tensor__", true.into()), ("raw", text(""))])), "a map of 2 keys: \"__tensor__\", \"raw\""),
        (one(map([("\u{1b}[2J", Value::Nil)])), "a map of 1 keys: \"\\u{1b}[2J\""),
        (one(nd("|O", "O")), "pickle"),
        (one(nd("<V2", "V")), "send float32"),
        (one(nd("<c8", "")), "its elements are \"<c8\""),
        (one(text("[[1]]")), "'left_arm' from the model server: it is text"),
        (one(Value::Array(vec![Value::Array(vec![1.into()]), Value::Array(vec![])])), "different shapes"),
        (one(Value::Array(vec![text("x")])), "it has text in it"),
        (one(Value::Array(vec![1.into()])), "its shape is [1]"),
        (text("x"), "its actions are text, not a map"),
    ] {
        let error = gr00t::chunk_of(&value).unwrap_err().to_string();
        assert!(error.contains(says), "{says}: {error}");
    }
    let config = |value: Value| gr00t::contract(&map([("action", value)])).unwrap_err().to_string();
    let unknown = config(map([("__ModalityConfig__", true.into()), ("as_yaml", text("x"))]));
    assert!(unknown.contains("no list 'modality_keys'") && unknown.contains("\"as_yaml\""), "{unknown}");
    assert!(config(map([("as_json", text("{"))])).contains("not JSON"));
    assert!(gr00t::contract(&Value::from(3)).unwrap_err().to_string().contains("a number"));
    let openpi = |value: Value| openpi::read(&value, Dialect::Openpi, 3).unwrap_err().to_string();
    assert!(openpi(map([("normalized_actions", 1.into())])).contains("a map of 1 keys: \"normalized_actions\""));
    let refused = map([("ok", false.into()), ("error", map([("message", text("no unnorm_key"))]))]);
    assert!(openpi(refused).contains("refuses 'infer': no unnorm_key"));
}
