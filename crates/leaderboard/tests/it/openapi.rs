//! Compares the document of the API with its routes and with real answers.

use std::collections::BTreeSet;

use crate::common::{Board, bag, manifest, wish};
use fiatlux_leaderboard::ServiceOptions;
use serde_json::{Value, json};

const METHODS: [&str; 5] = ["get", "post", "put", "delete", "patch"];

/// The first violation of a schema by a value; supports the part of JSON Schema that our document uses.
fn misfit(document: &Value, schema: &Value, value: &Value, at: &str) -> Option<String> {
    if let Some(target) = schema["$ref"].as_str() {
        let name = target.strip_prefix("#/components/schemas/").unwrap();
        let schema = &document["components"]["schemas"][name];
        assert!(schema.is_object(), "{target} does not exist");
        return misfit(document, schema, value, at);
    }
    if let Some(choices) = schema["oneOf"].as_array() {
        let fits = choices.iter().filter(|choice| misfit(document, choice, value, at).is_none()).count();
        return (fits != 1).then(|| format!("{at} fits {fits} of its choices"));
    }
    if let Some(words) = schema["enum"].as_array()
        && !words.contains(value)
    {
        return Some(format!("{at} is {value}"));
    }
    let is_type = match schema["type"].as_str().unwrap() {
        "object" => value.is_object(),
        "array" => value.is_array(),
        "string" => value.is_string(),
        "boolean" => value.is_boolean(),
        "null" => value.is_null(),
        "integer" => value.is_i64() || value.is_u64(),
        other => panic!("{other} is a type unknown to this test"),
    };
    if !is_type {
        return Some(format!("{at} is {value}, not of type {}", schema["type"]));
    }
    for item in value.as_array().into_iter().flatten() {
        let wrong = misfit(document, &schema["items"], item, &format!("{at}[]"));
        if wrong.is_some() {
            return wrong;
        }
    }
    for name in schema["required"].as_array().into_iter().flatten() {
        if value.get(name.as_str().unwrap()).is_none() {
            return Some(format!("{at} lacks {name}"));
        }
    }
    let known = schema["properties"].as_object()?;
    value.as_object().into_iter().flatten().find_map(|(name, value)| match known.get(name) {
        Some(schema) => misfit(document, schema, value, &format!("{at}.{name}")),
        None => Some(format!("{at} has {name}, which the document does not have")),
    })
}

/// Guards that the document lists exactly the addresses and methods that exist.
#[test]
fn the_document_has_every_route() {
    let board = Board::start("openapi-routes", ServiceOptions::default());
    let (status, document) = board.json("GET", "/api/openapi.json", None, &Value::Null);
    assert_eq!((status, &document["openapi"]), (200, &json!("3.1.0")));
    let documented: BTreeSet<&str> = document["paths"].as_object().unwrap().keys().map(String::as_str).collect();
    let source = include_str!("../../src/api.rs");
    let routed: BTreeSet<&str> = source
        .split(".route(\"")
        .skip(1)
        .map(|rest| rest.split('"').next().unwrap())
        .filter(|path| !path.contains('*'))
        .collect();
    assert_eq!(documented, routed);
    for path in routed {
        let address = path.replace("{id}", "0123456789abcdef").replace("{place}", "0");
        for method in METHODS {
            let (status, _) = board.ask(&method.to_uppercase(), &address, None, b"");
            let is_documented = document["paths"][path].get(method).is_some();
            assert_eq!(status != 405, is_documented, "{method} {path}: {status}");
        }
    }
}

/// Guards that answers match the document, errors included.
#[test]
fn answers_are_as_documented() {
    let board = Board::start("openapi-answers", ServiceOptions::default());
    let token = board.token("lab");
    let (_, document) = board.json("GET", "/api/openapi.json", None, &Value::Null);
    let check = |path: &str, method: &str, (status, answer): (u16, Value)| {
        let said = &document["paths"][path][method]["responses"][status.to_string()];
        let schema = &said["content"]["application/json"]["schema"];
        assert!(schema.is_object(), "{method} {path}: {status} is not documented: {answer}");
        assert_eq!(misfit(&document, schema, &answer, "answer"), None, "{method} {path} {status}: {answer}");
        answer
    };
    let account = token;
    let token = Some(&*account);
    let file = bag(&board.folder.0, 3);
    let wished = wish(&manifest(), std::slice::from_ref(&file));
    let [all, one, put, finish, results] = [
        "/api/v1/submissions",
        "/api/v1/submissions/{id}",
        "/api/v1/submissions/{id}/files/{place}",
        "/api/v1/submissions/{id}/finish",
        "/api/v1/submissions/{id}/results",
    ];
    check(all, "post", board.json("POST", all, None, &wished));
    check(all, "post", board.json("POST", all, token, &json!({})));
    let begun = check(all, "post", board.json("POST", all, token, &wished));
    check(all, "post", board.json("POST", all, token, &wished));
    let id = begun["id"].as_str().unwrap();
    let at = |path: &str| path.replace("{id}", id).replace("{place}", "0");
    check(one, "get", board.json("GET", &at(one), token, &Value::Null));
    check(one, "get", board.json("GET", &at(one), None, &Value::Null));
    check(finish, "post", board.json("POST", &at(finish), token, &Value::Null));
    check(results, "get", board.json("GET", &at(results), token, &Value::Null));
    let bytes = std::fs::read(file).unwrap();
    let put_at = |offset: usize, bytes: &[u8]| {
        let (status, text) = board.ask("PUT", &format!("{}?offset={offset}", at(put)), token, bytes);
        check(put, "put", (status, serde_json::from_str(&text).unwrap()));
        status
    };
    assert_eq!([put_at(0, &bytes[..10]), put_at(0, &bytes), put_at(10, &bytes[10..])], [200, 409, 200]);
    check(finish, "post", board.json("POST", &at(finish), token, &Value::Null));
    board.decided(id, &account);
    check(one, "get", board.json("GET", &at(one), None, &Value::Null));
    check(all, "get", board.json("GET", all, None, &Value::Null));
    check("/api/v1/account", "get", board.json("GET", "/api/v1/account", token, &Value::Null));
    let (status, _) = board.json("GET", &at(results), None, &Value::Null);
    assert_eq!(status, 200);
    for path in ["/health", "/ready"] {
        assert_eq!(board.ask("GET", path, None, b"").0, 200, "{path}");
    }
}
