//! The page's server: who gets what, and that no page can break it.

use std::io::{Read, Write};
use std::net::{Ipv4Addr, SocketAddr, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

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
        Self::called(&[])
    }

    /// A server that is also called by other names.
    fn called(names: &[&str]) -> Self {
        let any = SocketAddr::from((Ipv4Addr::LOCALHOST, 0));
        let names: Vec<String> = names.iter().map(|name| (*name).to_owned()).collect();
        let cockpit = Cockpit::bind(any, &names, Arc::new(Station::default())).expect("a free port");
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
        code(&self.ask(path, &format!("{host}\r\nConnection: close")))
    }

    /// An answer after which the server closes the connection.
    fn ask(&self, path: &str, host: &str) -> String {
        let mut stream = self.tcp();
        write!(stream, "GET {path} HTTP/1.1\r\nHost: {host}\r\n\r\n").expect("sent");
        let mut answer = String::new();
        stream.read_to_string(&mut answer).expect("an answer that ends");
        answer
    }

    fn tcp(&self) -> TcpStream {
        let stream = TcpStream::connect(&self.address).expect("it listens");
        stream.set_read_timeout(Some(Duration::from_secs(20))).expect("set");
        stream
    }

    fn socket(&self, query: &str) -> Result<WebSocket<TcpStream>, String> {
        let url = format!("ws://{}/drive{query}", self.address);
        tungstenite::client(url, self.tcp()).map(|(socket, _)| socket).map_err(|error| error.to_string())
    }

    /// The code of the answer to a WebSocket of a page of `origin`, which was asked for as `host`.
    fn socket_from(&self, host: &str, origin: &str) -> u16 {
        let path = format!("/drive?token={}", self.token);
        let mut stream = self.tcp();
        write!(
            stream,
            "GET {path} HTTP/1.1\r\nHost: {host}\r\nOrigin: {origin}\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n\
             Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
        )
        .expect("sent");
        let mut answer = [0; 12];
        stream.read_exact(&mut answer).expect("an answer");
        code(&String::from_utf8_lossy(&answer))
    }
}

fn code(answer: &str) -> u16 {
    answer.split(' ').nth(1).and_then(|code| code.parse().ok()).expect("a code")
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

/// A page of another host that resolves to this machine is refused, token or not. A tunnel listens on another port.
#[test]
fn the_server_answers_to_its_own_names_on_every_port() {
    let served = Served::called(&["robot.example.org"]);
    let path = format!("/?token={}", served.token);
    for host in ["localhost:9000", "127.0.0.1:1", "[::1]:9000", "localhost", "robot.example.org"] {
        assert_eq!(served.get(&path, host), 200, "{host}");
    }
    for host in
        ["example.org", "localhost.example.org:9000", "evil.robot.example.org", "", "localhost\r\nHost: example.org"]
    {
        assert_eq!(served.get(&path, host), 421, "{host}");
    }
}

/// Guards that the token alone is not enough for a page of another host.
#[test]
fn only_the_servers_own_page_connects() {
    let served = Served::called(&["robot.example.org"]);
    let own = served.address.clone();
    let cases = [
        (own.as_str(), format!("http://{own}"), 101),
        ("localhost:9000", "http://localhost:9000".into(), 101),
        // A tunnel that changes the name, and the page keeps it.
        (&own, "https://robot.example.org".into(), 101),
        ("localhost:9000", "http://evil.example:9000".into(), 403),
        ("localhost:9000", "http://localhost:3000".into(), 403),
        (&own, "null".into(), 403),
        (&own, "file://".into(), 403),
    ];
    for (host, origin, expected) in cases {
        assert_eq!(served.socket_from(host, &origin), expected, "{origin} at {host}");
    }
}

/// A reloaded page shows no token in its address: it finds the one that its tab keeps, and gets nothing else.
#[test]
fn the_page_without_its_token_is_a_door() {
    let served = Served::start();
    let answer = served.ask("/", &served.address);
    assert_eq!(code(&answer), 403);
    assert!(answer.contains("/page/door.js") && answer.contains("script-src 'self';"), "{answer}");
    assert!(!answer.contains(&served.token));
    assert_eq!(served.get("/page/door.js", &served.address), 200);
    assert_eq!(served.get("/page/token.js", &served.address), 200);
}

/// Guards that refused requests keep no connection: each of these asks on one that could stay.
#[test]
fn a_refused_request_ends_its_connection() {
    let served = Served::start();
    for (path, expected) in [("/", 403), ("/drive", 403), ("/document.json?token=1", 403), ("/nothing", 404)] {
        assert_eq!(code(&served.ask(path, &served.address)), expected, "{path}");
    }
    assert_eq!(code(&served.ask("/", "example.org")), 421);
}

/// Guards the operator against programs of this machine that connect and say nothing, or half a request.
#[test]
fn silent_connections_end_and_keep_nobody_out() {
    let served = Served::start();
    let mut silent: Vec<TcpStream> = (0..400).map(|_| served.tcp()).collect();
    for stream in silent.iter_mut().step_by(2) {
        // Those that were closed already take nothing.
        drop(stream.write_all(b"GET / HTTP/1.1\r\nHost: loc"));
    }
    let asked = Instant::now();
    assert_eq!(served.get(&format!("/?token={}", served.token), &served.address), 200);
    assert!(asked.elapsed() < Duration::from_secs(1), "it took {:?}", asked.elapsed());
    for stream in &mut silent {
        let mut rest = Vec::new();
        let closed = stream.read_to_end(&mut rest);
        let is_closed = closed.is_ok_and(|_| true) || stream.write(&[0]).is_err();
        assert!(is_closed, "a silent connection is still open");
    }
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

/// The code with which the server ends the connection of a page.
fn farewell(socket: &mut WebSocket<TcpStream>) -> u16 {
    loop {
        match socket.read() {
            Ok(Message::Close(frame)) => return frame.expect("a reason").code.into(),
            Ok(_) => {}
            Err(error) => panic!("no farewell: {error}"),
        }
    }
}

/// Guards that whoever has the token always gets in: the page that has sent nothing for longest, and does not drive, makes room.
#[test]
fn the_newest_page_gets_in_and_the_driver_stays() {
    let served = Served::start();
    let query = format!("?token={}", served.token);
    let mut open: Vec<_> = (0..16).map(|_| served.socket(&query).expect("admitted")).collect();
    open[0].send(Message::text(r#"{"drive":true}"#)).expect("sent");
    while told(&mut open[0], "drives") != true {}
    for page in &mut open[2..] {
        page.send(Message::text(r#"{"input":"none"}"#)).expect("sent");
    }
    std::thread::sleep(Duration::from_millis(200));
    let mut newest = served.socket(&query).expect("admitted");
    assert_eq!(farewell(&mut open[1]), 4000);
    assert_eq!(told(&mut newest, "status")["phase"], "opening");
    open[0].send(Message::text(r#"{"drive":true}"#)).expect("sent");
    while told(&mut open[0], "drives") != true {}
}

#[test]
fn pages_are_told_that_the_program_ends() {
    let served = Served::start();
    let mut page = served.socket(&format!("?token={}", served.token)).expect("admitted");
    assert_eq!(told(&mut page, "status")["phase"], "opening");
    served.stop.store(true, Ordering::Relaxed);
    assert_eq!(farewell(&mut page), 1001);
}

/// Guards that pages that send without end take nothing from the operator's.
#[test]
fn a_flood_of_messages_waits_at_its_own_end() {
    let served = Served::start();
    let query = format!("?token={}", served.token);
    let stop = AtomicBool::new(false);
    let mut operator = served.socket(&query).expect("admitted");
    std::thread::scope(|scope| {
        for kind in 0..3 {
            let mut page = served.socket(&query).expect("admitted");
            let stop = &stop;
            scope.spawn(move || {
                page.get_ref().set_write_timeout(Some(Duration::from_millis(50))).expect("set");
                let text = ["{}".to_owned(), format!("{{\"data\":[{}0]}}", "0,".repeat(15_000)), "[".repeat(4000)];
                while !stop.load(Ordering::Relaxed) {
                    // What cannot be sent waits.
                    drop(page.send(Message::text(text[kind].clone())));
                }
            });
        }
        std::thread::sleep(Duration::from_millis(500));
        operator.send(Message::text(r#"{"drive":true}"#)).expect("sent");
        let began = Instant::now();
        for _ in 0..50 {
            operator.send(Message::text(r#"{"input":"none"}"#)).expect("sent");
            assert!(told(&mut operator, "problem").as_str().is_some_and(|problem| problem.contains("none")));
        }
        let took = began.elapsed();
        stop.store(true, Ordering::Relaxed);
        assert!(took < Duration::from_secs(5), "50 answers took {took:?}");
    });
}
