//! Hostile servers and other programs: no hang, no panic, an error with its reason.

use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::time::{Duration, Instant};

use fiatlux_bridge::{BridgeError, Dialect, Form, Model, ModelObservation, ModelOptions, Tensor, Timeouts};
use rmpv::Value;
use tungstenite::Message;
use tungstenite::handshake::server::{ErrorResponse, Request, Response};

const TIMEOUTS: Timeouts = Timeouts { connect: Duration::from_millis(800), reply: Duration::from_millis(800) };

/// Answers each connection with a function, in a thread that ends with the test process.
fn serve(answer: impl Fn(TcpStream) + Send + 'static) -> u16 {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = listener.local_addr().unwrap().port();
    std::thread::spawn(move || listener.incoming().for_each(|stream| answer(stream.unwrap())));
    port
}

fn model(dialect: Dialect, port: u16) -> Box<dyn Model> {
    let scheme = if dialect == Dialect::Gr00t { "tcp" } else { "ws" };
    let url = format!("{scheme}://127.0.0.1:{port}");
    ModelOptions { url, host: None, dialect, timeouts: TIMEOUTS, token: None }.model().unwrap()
}

fn ask(dialect: Dialect, port: u16) -> BridgeError {
    let start = Instant::now();
    let error = model(dialect, port).contract().unwrap_err();
    assert!(start.elapsed() < Duration::from_secs(3), "{error}");
    error
}

/// Sends a ZeroMQ greeting and the READY of a socket of this kind; returns what the client sent meanwhile.
fn greeted(stream: &mut TcpStream, kind: &str) -> Vec<u8> {
    let mut greeting = [0; 64];
    (greeting[0], greeting[9], greeting[10], greeting[11]) = (0xff, 0x7f, 3, 1);
    greeting[12..16].copy_from_slice(b"NULL");
    stream.write_all(&greeting).unwrap();
    let mut ready = b"\x05READY\x0bSocket-Type".to_vec();
    ready.extend((kind.len() as u32).to_be_bytes());
    ready.extend(kind.as_bytes());
    stream.write_all(&[4, ready.len() as u8]).unwrap();
    stream.write_all(&ready).unwrap();
    // Read the greeting, READY and the question.
    let (mut sent, mut buffer) = (Vec::new(), [0; 4096]);
    while sent.len() < 100 {
        let read = stream.read(&mut buffer).unwrap();
        sent.extend_from_slice(&buffer[..read]);
    }
    sent
}

#[test]
fn zeromq_servers_that_are_none() {
    let nobody = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    assert!(matches!(ask(Dialect::Gr00t, nobody), BridgeError::Connect { .. }));
    // Silent, closing at once, speaking another protocol, sending one byte at a time.
    let silent = serve(std::mem::forget);
    assert!(ask(Dialect::Gr00t, silent).to_string().contains("did not complete the ZeroMQ handshake within 0.8 s"));
    let gone = serve(drop);
    assert!(ask(Dialect::Gr00t, gone).is_transient());
    let web = serve(|mut stream| drop(stream.write_all(&b"HTTP/1.1 400 Bad Request\r\n".repeat(4))));
    assert!(ask(Dialect::Gr00t, web).to_string().contains("not a ZeroMQ greeting"));
    let drip = serve(|mut stream| {
        while stream.write_all(&[0xff]).is_ok() {
            std::thread::sleep(Duration::from_millis(100));
        }
    });
    assert!(ask(Dialect::Gr00t, drip).to_string().contains("--reply-timeout"));
    let publisher = serve(|mut stream| drop(greeted(&mut stream, "PUB")));
    assert!(ask(Dialect::Gr00t, publisher).to_string().contains("\"PUB\""));
}

#[test]
fn hostile_zeromq_answers() {
    type Case = (&'static [u8], &'static str);
    let cases: [Case; 8] = [
        // An empty frame, then 2^62 bytes are announced.
        (&[1, 0, 2, 0x40, 0, 0, 0, 0, 0, 0, 0], "sends 4611686018427387904 bytes"),
        (&[1, 0, 2, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff], "bytes; the limit is"),
        // Half of a frame.
        (&[1, 0, 0, 200, 1, 2, 3], "within 0.8 s"),
        // No empty frame, too many frames, unknown flags.
        (&[0, 1, 0xc0], "not one frame after an empty one"),
        (&[1, 0, 1, 0, 1, 0, 0, 0], "not one frame after an empty one"),
        (&[0x80, 0], "flags are 0x80"),
        // Not a map, and an array of four billion.
        (&[1, 0, 0, 1, 0xc1], "no 'action'"),
        (&[1, 0, 0, 5, 0xdd, 0xff, 0xff, 0xff, 0xff], "not MessagePack"),
    ];
    for (answer, says) in cases {
        let port = serve(move |mut stream| {
            greeted(&mut stream, "REP");
            stream.write_all(answer).unwrap();
            std::mem::forget(stream);
        });
        let error = ask(Dialect::Gr00t, port).to_string();
        assert!(error.contains(says), "{says}: {error}");
    }
    let port = serve(|mut stream| {
        greeted(&mut stream, "REP");
        stream.write_all(&[1, 0, 0, 5]).unwrap();
        stream.write_all(b"ERROR").unwrap();
        std::mem::forget(stream);
    });
    assert!(ask(Dialect::Gr00t, port).to_string().contains("see its log"));
}

#[test]
fn hostile_websockets() {
    let silent = serve(std::mem::forget);
    assert!(ask(Dialect::Openpi, silent).to_string().contains("did not complete the WebSocket handshake within 0.8 s"));
    let not_there = serve(|mut stream| {
        let _ = stream.read(&mut [0; 512]);
        let _ = stream.write_all(b"HTTP/1.1 404 Not Found\r\nContent-Length: 0\r\n\r\n");
    });
    assert!(ask(Dialect::Openpi, not_there).to_string().contains("404"));
    type Case = (&'static [u8], &'static str);
    let cases: [Case; 6] = [
        // A frame of 2^62 bytes, half a frame, a reserved opcode, text, a map cut short, a number.
        (&[0x82, 127, 0x40, 0, 0, 0, 0, 0, 0, 0], "bytes; the limit is"),
        (&[0x82, 100, 1, 2, 3], "within 0.8 s"),
        (&[0x83, 0], "lost"),
        (&[0x81, 2, b'n', b'o'], "refuses 'metadata': no"),
        (&[0x82, 1, 0x81], "not MessagePack"),
        (&[0x82, 1, 0x07], "not a map"),
    ];
    for (frame, says) in cases {
        let port = serve(move |stream| {
            let mut socket = tungstenite::accept(stream).unwrap();
            socket.get_mut().write_all(frame).unwrap();
            std::mem::forget(socket);
        });
        let error = ask(Dialect::Openpi, port).to_string();
        assert!(error.contains(says), "{says}: {error}");
    }
}

fn packed(value: &Value) -> Vec<u8> {
    let mut bytes = Vec::new();
    rmpv::encode::write_value(&mut bytes, value).unwrap();
    bytes
}

fn observation() -> ModelObservation {
    ModelObservation { states: vec![("waist".into(), vec![1.0, 2.0])], ..ModelObservation::default() }
}

/// Answers one question of GR00T by a function of the client's bytes.
fn answered(stream: &mut TcpStream, answer: impl Fn(&[u8]) -> Value) {
    let mut sent = greeted(stream, "REP");
    // The request has ended when nothing more arrives for a while.
    stream.set_read_timeout(Some(Duration::from_millis(100))).unwrap();
    let _ = stream.read_to_end(&mut sent);
    let answer = packed(&answer(&sent));
    stream.write_all(&[1, 0, 0, answer.len() as u8]).unwrap();
    stream.write_all(&answer).unwrap();
}

/// Guards that the request after an unusable answer uses a new connection: the old one may still send the late answer.
#[test]
fn a_connection_does_not_outlive_an_error() {
    let good = || Tensor::f32(vec![1, 2], &[1.0, 2.0]).unwrap().write(Form::Openpi);
    let map = |value: Value| Value::Map(vec![("actions".into(), value)]);
    let answers = std::sync::Mutex::new(vec![map(good()), map("none".into())]);
    let port = serve(move |stream| {
        let mut socket = tungstenite::accept(stream).unwrap();
        socket.send(Message::binary(packed(&Value::Map(vec![])))).unwrap();
        socket.read().unwrap();
        socket.send(Message::binary(packed(&answers.lock().unwrap().pop().unwrap()))).unwrap();
    });
    let mut openpi = model(Dialect::Openpi, port);
    let error = openpi.infer(&observation()).unwrap_err();
    assert!(matches!(error, BridgeError::Malformed { .. }) && !error.is_transient(), "{error}");
    assert_eq!(openpi.infer(&observation()).unwrap().rows, 1);

    let actions = |value: Value| Value::Array(vec![map(value)]);
    let answers = std::sync::Mutex::new(vec![actions(good()), actions("none".into())]);
    let port = serve(move |mut stream| {
        let answer = answers.lock().unwrap().pop().unwrap();
        answered(&mut stream, |_| answer.clone());
    });
    let mut gr00t = model(Dialect::Gr00t, port);
    assert!(matches!(gr00t.infer(&observation()).unwrap_err(), BridgeError::Malformed { .. }));
    assert_eq!(gr00t.infer(&observation()).unwrap().rows, 1);
}

/// Some servers of GR00T N1.7 read only arrays of msgpack-numpy, older ones only `.npy` files.
#[test]
fn a_refused_form_of_arrays_is_changed_once() {
    let (npy, numpy) = (b"__ndarray_class__".as_slice(), b"\xc4\x02nd".as_slice());
    let good = Tensor::f32(vec![1, 1, 2], &[1.0, 2.0]).unwrap().write(Form::MsgpackNumpy);
    let answer = Value::Array(vec![Value::Map(vec![("waist".into(), good)]), Value::Map(vec![])]);
    let refusal = |words: &str| Value::Map(vec![("error".into(), words.into())]);
    let reads = move |form: &'static [u8], other: &'static [u8]| {
        let answer = answer.clone();
        serve(move |mut stream| {
            answered(&mut stream, |sent| {
                let has = |form: &[u8]| sent.windows(form.len()).any(|bytes| bytes == form);
                assert!(has(form) != has(other));
                if has(form) { answer.clone() } else { refusal("waist is a dict") }
            });
        })
    };
    for (form, other) in [(npy, numpy), (numpy, npy)] {
        let mut model = model(Dialect::Gr00t, reads(form, other));
        assert_eq!(model.infer(&observation()).unwrap().parts[0].2, [1.0, 2.0]);
    }
    // A request that is refused in both forms gives the first reason.
    let count = std::sync::atomic::AtomicUsize::new(0);
    let port = serve(move |mut stream| {
        let count = count.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
        answered(&mut stream, |_| refusal(["no GPU", "a dict"][count.min(1)]));
    });
    assert!(model(Dialect::Gr00t, port).infer(&observation()).unwrap_err().to_string().contains("no GPU"));
}

/// The handshake of WebSocket names host, port and path as the URL does, or the host behind a tunnel.
#[test]
fn the_handshake_names_the_host() {
    handshake("127.0.0.1", "", None, "127.0.0.1:PORT");
    handshake("127.0.0.1", "/v1", Some("model.example.org:8443"), "model.example.org:8443");
}

#[test]
#[ignore = "needs IPv6: tests/run"]
fn the_handshake_names_the_host_by_ipv6() {
    handshake("[::1]", "/v1/model?key=1", None, "[::1]:PORT");
}

#[allow(clippy::result_large_err)] // The error is the library's.
fn handshake(address: &str, path: &str, host: Option<&str>, expected: &str) {
    let listener = TcpListener::bind(format!("{address}:0")).unwrap();
    let port = listener.local_addr().unwrap().port();
    let seen = std::thread::spawn(move || {
        let mut seen = (String::new(), String::new());
        let note = |request: &Request, response: Response| -> Result<Response, ErrorResponse> {
            seen = (request.headers()["Host"].to_str().unwrap().into(), request.uri().to_string());
            Ok(response)
        };
        let mut socket = tungstenite::accept_hdr(listener.accept().unwrap().0, note).unwrap();
        socket.send(Message::binary(packed(&Value::Map(vec![])))).unwrap();
        seen
    });
    let url = format!("ws://{address}:{port}{path}");
    let host = host.map(str::to_owned);
    let options = ModelOptions { url, host, dialect: Dialect::Openpi, timeouts: TIMEOUTS, token: None };
    options.model().unwrap().contract().unwrap();
    let path = if path.is_empty() { "/" } else { path };
    assert_eq!(seen.join().unwrap(), (expected.replace("PORT", &port.to_string()), path.to_owned()));
}
