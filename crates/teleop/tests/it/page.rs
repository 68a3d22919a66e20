//! The page's server: who gets what, and that no page can break it.

use std::io::{Read, Write};
use std::net::{Ipv4Addr, SocketAddr, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use fiatlux_teleop::{Cockpit, Station};
use tungstenite::{Message, WebSocket};

struct Served {
    address: String,
    token: String,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Served {
    fn start() -> Self {
        let any = SocketAddr::from((Ipv4Addr::LOCALHOST, 0));
        let cockpit = Cockpit::bind(any, Arc::new(Station::default())).expect("a free port");
        let url = cockpit.url();
        let (address, token) = url.strip_prefix("http://").and_then(|url| url.split_once("/?token=")).expect("a url");
        let stop = Arc::new(AtomicBool::new(false));
        let flag = Arc::clone(&stop);
        let (address, token) = (address.to_owned(), token.to_owned());
        let thread = std::thread::spawn(move || cockpit.serve(&flag).expect("it serves"));
        Self { address, token, stop, thread: Some(thread) }
    }

    /// The status line's code of an answer.
    fn get(&self, path: &str, host: &str) -> u16 {
        let mut stream = TcpStream::connect(&self.address).expect("it listens");
        write!(stream, "GET {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n").expect("sent");
        let mut answer = String::new();
        stream.read_to_string(&mut answer).expect("an answer");
        answer.split(' ').nth(1).and_then(|code| code.parse().ok()).expect("a code")
    }

    fn socket(&self, query: &str) -> Result<WebSocket<TcpStream>, String> {
        let stream = TcpStream::connect(&self.address).expect("it listens");
        stream.set_read_timeout(Some(Duration::from_secs(10))).expect("set");
        let url = format!("ws://{}/drive{query}", self.address);
        tungstenite::client(url, stream).map(|(socket, _)| socket).map_err(|error| error.to_string())
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        let ended = self.thread.take().map(JoinHandle::join);
        assert!(std::thread::panicking() || ended.is_none_or(|ended| ended.is_ok()), "the server panicked");
    }
}

/// The next text that has a key.
fn told(socket: &mut WebSocket<TcpStream>, key: &str) -> serde_json::Value {
    loop {
        if let Message::Text(text) = socket.read().expect("a message") {
            let message: serde_json::Value = serde_json::from_str(&text).expect("JSON");
            if let Some(value) = message.get(key) {
                return value.clone();
            }
        }
    }
}

#[test]
fn a_stranger_without_the_token_gets_nothing() {
    let served = Served::start();
    let (address, token) = (served.address.clone(), served.token.clone());
    for path in ["/", "/document.json", "/meshes.bin", "/drive"] {
        assert_eq!(served.get(path, &address), 403, "{path}");
        assert_eq!(served.get(&format!("{path}?token={}0", &token[1..]), &address), 403, "{path}");
        assert_eq!(served.get(&format!("{path}?token={}", &token[..8]), &address), 403, "{path}");
    }
    for path in ["/", "/document.json", "/meshes.bin"] {
        assert_eq!(served.get(&format!("{path}?token={token}"), &address), 200, "{path}");
    }
    assert_eq!(served.get(&format!("/drive?token={token}"), &address), 400, "it is for a WebSocket");
    assert_eq!(served.get("/page/teleop.js", &address), 200, "the same for everybody");
    assert_eq!(served.get("/page/stage.js", &address), 200);
    assert_eq!(served.get("/page/..%2fCargo.toml", &address), 404);
    assert!(served.socket("").is_err_and(|error| error.contains("403")));
    assert!(served.socket(&format!("?token={}", "0".repeat(token.len()))).is_err_and(|error| error.contains("403")));
    assert!(served.socket(&format!("?token={token}")).is_ok());
}

/// A page of another host that resolves to this machine is refused, token or not.
#[test]
fn the_server_answers_to_its_own_name_alone() {
    let served = Served::start();
    let path = format!("/?token={}", served.token);
    assert_eq!(served.get(&path, "example.org"), 421);
    assert_eq!(served.get(&path, "127.0.0.1:1"), 421);
}

#[test]
fn the_newest_page_drives_and_the_others_are_told() {
    let served = Served::start();
    let query = format!("?token={}", served.token);
    let mut first = served.socket(&query).expect("admitted");
    assert_eq!(told(&mut first, "status")["phase"], "opening");
    assert_eq!(told(&mut first, "drives"), true);
    let second = served.socket(&query).expect("admitted");
    assert_eq!(told(&mut first, "drives"), false);
    first.send(Message::text(r#"{"drive":true}"#)).expect("sent");
    assert_eq!(told(&mut first, "drives"), true);
    drop(second);
    first.send(Message::text(r#"{"input":"gamepad","at":1,"data":{"axes":[1e999]}}"#)).expect("sent");
    assert!(told(&mut first, "problem").as_str().is_some_and(|problem| problem.contains("reload")), "it is told");
}

/// Garbage, messages that are too large, half messages and pages that come and go: the next page is served.
#[test]
fn hostile_pages_break_nothing() {
    let served = Served::start();
    let query = format!("?token={}", served.token);
    for round in 0..40_u8 {
        let mut socket = served.socket(&query).expect("admitted");
        let bytes: Vec<u8> = (0..200_u8).map(|byte| byte.wrapping_mul(round).wrapping_add(37)).collect();
        match round % 5 {
            0 => drop(socket.get_mut().write_all(&bytes)),
            1 => drop(socket.send(Message::text("x".repeat(100_000)))),
            2 => drop(socket.send(Message::binary(bytes))),
            3 => drop(socket.send(Message::text(r#"{"input":"webxr","at":0,"data":{"space":-1}}"#))),
            _ => drop(socket.get_mut().write_all(&[0x81, 0xfe])),
        }
    }
    std::thread::sleep(Duration::from_millis(200));
    let mut socket = served.socket(&query).expect("the pages before are gone");
    assert_eq!(told(&mut socket, "drives"), true);
}

#[test]
fn pages_are_limited() {
    let served = Served::start();
    let query = format!("?token={}", served.token);
    let open: Vec<_> = (0..16).map(|_| served.socket(&query).expect("admitted")).collect();
    assert!(served.socket(&query).is_err_and(|error| error.contains("503")));
    drop(open);
}
