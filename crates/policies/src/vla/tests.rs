use std::error::Error;
use std::net::TcpListener;

use fiatlux_bridge::{Dialect, Form, ModelChunk, Tensor};
use tungstenite::Message;

use super::*;

/// The record has the whole chunk once, within the protocol's limits, and the origin of each action.
#[test]
fn a_note_becomes_a_record_within_bounds() {
    assert_eq!(Note::default().record(), None);
    let part = |key: &str, width: usize, rows: usize| (key.to_owned(), width, vec![0.5; width * rows]);
    let chunk = ModelChunk { rows: 30, parts: vec![part("left_arm", 7, 30), part("waist", 3, 30)], server_s: None };
    let note = |chunk, problem: &str| Note {
        chunk: Some(chunk),
        latency_s: 0.2,
        server_s: Some(0.145),
        problem: problem.into(),
        played: Some((2, 4, 5)),
    };
    let record = note(chunk, "").record().expect("a record");
    assert_eq!((record.index, record.row, record.values.len(), record.width), (2, 4, 300, 10));
    assert_eq!(record.keys, ["left_arm:7", "waist:3"]);
    assert!((record.age_s - 0.1).abs() < 1e-12);
    let large = ModelChunk { rows: 400, parts: vec![part("all", 512, 400)], server_s: None };
    let record = note(large, &"ü".repeat(300)).record().expect("a record");
    assert_eq!((record.values.len(), record.width, record.problem.len()), (0, 0, 256));
}

#[test]
fn flags_that_are_missing_are_told() {
    let error = |args: VlaArgs| args.source(false).err().map(|error| format!("{error} {error:?}")).unwrap_or_default();
    assert!(error(VlaArgs::default()).contains("--dialect and --model"));
    let model = |map: Option<&str>, url: &str| VlaArgs {
        dialect: Some(Dialect::Gr00t),
        model: Some(url.into()),
        map: map.map(str::to_owned),
        ..VlaArgs::default()
    };
    assert!(error(model(None, "ws://lab:1")).contains("Address"));
    assert!(error(model(Some("openpi_g1"), "tcp://lab:1")).contains("it is not for gr00t"));
    assert!(error(VlaArgs { prefix: Some(31), ..model(None, "tcp://lab:1") }).contains("a chunk has 30 rows"));
    assert!(error(model(None, "tcp://lab:1")).is_empty());
    let on = |controller: &str| VlaArgs { controller: Some(controller.into()), ..model(None, "tcp://lab:1") };
    assert!(error(on("own")).is_empty());
    for controller in ["sonic:x", "gear", "gear:", "own:x", "walk"] {
        let said = error(on(controller));
        assert!(said.contains(&format!("'{controller}', but the mapping unitree_g1 outputs commands")), "{said}");
    }
    assert!(error(on("gear:/nowhere")).contains("/nowhere/Balance.onnx"));
    assert!(error(on("gear:/nowhere,vx=1")).contains("use names of reading, gains"));
}

/// A server of openpi that takes a while for its first answer, as one that compiles does; returns its address.
fn slow_at_first(time: Duration) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    let url = format!("ws://{}", listener.local_addr().expect("an address"));
    std::thread::spawn(move || {
        let pack = |value: rmpv::Value| {
            let mut bytes = Vec::new();
            rmpv::encode::write_value(&mut bytes, &value).expect("memory");
            Message::binary(bytes)
        };
        let actions = Tensor::f32(vec![50, 23], &[0.0; 50 * 23]).expect("an array").write(Form::Openpi);
        let mut left = time;
        for stream in listener.incoming() {
            let mut socket = tungstenite::accept(stream.expect("a connection")).expect("a handshake");
            let _ = socket.send(pack(rmpv::Value::Map(vec![])));
            while let Ok(Message::Binary(_)) = socket.read() {
                std::thread::sleep(std::mem::take(&mut left));
                let _ = socket.send(pack(rmpv::Value::Map(vec![("actions".into(), actions.clone())])));
            }
        }
    });
    url
}

/// A server that compiles for its first answer is waited for before an episode, by a time of its own; where it takes longer, the
/// error says so, and not that the dialect is wrong.
#[test]
fn a_first_answer_may_take_long() {
    let checked = |time: Duration, warm_up: u16| {
        let args = VlaArgs {
            dialect: Some(Dialect::Openpi),
            model: Some(slow_at_first(time)),
            reply_timeout: Some(1),
            warm_up_timeout: Some(warm_up),
            ..VlaArgs::default()
        };
        args.checked(false)
    };
    let slow = Duration::from_millis(1500);
    let source = checked(slow, 10).expect("it waits");
    let answer = source.probe().expect("a contract").answer.expect("an answer");
    assert!(answer.rows.is_ok() && answer.latency < Duration::from_secs(1), "no episode pays for it");
    let error = checked(slow, 1).err().and_then(|error| error.source().map(ToString::to_string)).expect("too slow");
    assert!(
        error.contains("within 1 s") && error.contains("--warm-up-timeout") && !error.contains("dialect"),
        "{error}"
    );
    // Without that question the first one of the episode pays, and the reason is time as well, also while the server is busy.
    let source = checked(Duration::from_secs(4), 0).expect("no question");
    let mut client = ModelClient::new(source.0.options.model().expect("an address"), Duration::from_millis(1500));
    let error = client.ask(&source.example().expect("an observation")).err().expect("too slow").to_string();
    assert!(error.contains("--reply-timeout"), "{error}");
}
