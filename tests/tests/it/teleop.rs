//! A person who drives the robot of a server elsewhere: the page and the policy are one process, the server another.

use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::time::{Duration, Instant};

use fiatlux_bag::Completeness;
use fiatlux_tests::programs::{PATIENCE, Running, Scratch, Service, endpoint};
use serde_json::Value;
use tungstenite::{Message, WebSocket};

/// Bytes of a state before its poses, of which the pelvis's is the first.
const HEAD_BYTES: usize = 64;

/// A page in a browser, as far as its connection goes.
struct Page(WebSocket<TcpStream>);

impl Page {
    fn open(url: &str) -> Self {
        let (address, query) = url.strip_prefix("http://").and_then(|url| url.split_once('/')).unwrap();
        let stream = TcpStream::connect(address).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        Self(tungstenite::client(format!("ws://{address}/drive{query}"), stream).unwrap().0)
    }

    /// The next status of which something is so.
    fn until(&mut self, is_so: impl Fn(&Value) -> bool) -> Value {
        let start = Instant::now();
        loop {
            assert!(start.elapsed() < PATIENCE, "the status does not come");
            let Message::Text(text) = self.0.read().unwrap() else { continue };
            let status = serde_json::from_str::<Value>(&text).unwrap()["status"].take();
            if !status.is_null() && is_so(&status) {
                return status;
            }
        }
    }

    fn phase(&mut self, phase: &str) -> Value {
        self.until(|status| status["phase"] == phase)
    }

    fn order(&mut self, order: &str) {
        self.0.send(Message::text(format!(r#"{{"order":"{order}"}}"#))).unwrap();
    }

    /// Holds a key for a while; returns how far the pelvis went, m.
    fn hold(&mut self, key: &str, time: Duration) -> f32 {
        let (start, mut places) = (Instant::now(), Vec::new());
        while start.elapsed() < time {
            let data = format!(r#"{{"keys":["{key}"],"focused":true,"running":true}}"#);
            self.0.send(Message::text(format!(r#"{{"input":"keyboard","at":1,"data":{data}}}"#))).unwrap();
            if let Message::Binary(state) = self.0.read().unwrap() {
                let (numbers, _) = state[HEAD_BYTES..].as_chunks::<4>();
                places.push([0, 1].map(|axis| f32::from_le_bytes(numbers[axis])));
            }
        }
        let [from, to] = [places[0], places[places.len() - 1]];
        (to[0] - from[0]).hypot(to[1] - from[1])
    }
}

fn teleop(port: u16, folder: &Scratch, more: &[&str]) -> Running {
    let endpoint = endpoint(port);
    let args = ["teleop", "--task", "S07", "--seed", "4", "--no-open", "-e", &endpoint];
    Running::start("policy-client", &[&args[..], more].concat(), folder)
}

/// Takes are driven, kept and verified on a server elsewhere. An operator may look at the room for longer than the server waits for
/// an action. When the server ends, its page says so, the bag of the take is whole, and the next take is played when the server
/// is back.
#[test]
fn takes_are_played_on_a_server_elsewhere() {
    let bags = Scratch::new("teleop-bags");
    let record = bags.path().display().to_string();
    let serve = ["--record", &record, "--action-timeout", "2"];
    let mut service = Service::start("teleop", &serve);
    let mut client = teleop(service.port, &service.folder, &[]);
    let url = client.wait_for("/?token=");
    let mut page = Page::open(&url);
    page.phase("ready");
    std::thread::sleep(Duration::from_secs(3));
    page.order("start");
    page.phase("running");
    let way = page.hold("KeyS", Duration::from_millis(1500));
    assert!(way > 0.05, "it walks: {way} m");
    page.order("stop");
    let ended = page.phase("ended");
    assert_eq!((ended["end"].as_str(), ended["problem"].as_str()), (Some("stopped"), Some("")));
    page.order("save");
    assert_eq!((page.phase("ready")["kept"].as_u64(), bags.files(".mcap").len()), (Some(1), 1));
    let first = bags.files(".mcap").remove(0).display().to_string();
    let args = ["verify", &first, "-e", &endpoint(service.port)];
    let (status, text) = Running::start("scorer", &args, &service.folder).finish(PATIENCE);
    assert!(status.success() && text.starts_with("equal: "), "{text}");

    page.order("start");
    page.phase("running");
    page.hold("KeyQ", Duration::from_millis(300));
    service.server.signal("TERM");
    assert!(service.server.finish(PATIENCE).0.success(), "all is recorded");
    let ended = page.phase("ended");
    assert!(ended["problem"].as_str().is_some_and(|problem| !problem.is_empty()), "{ended}");
    page.order("discard");
    let left =
        page.until(|status| status["problem"].as_str().is_some_and(|said| said.contains("stays with its server")));
    assert_eq!(left["kept"], 1);
    let all = ["--name", "test", "-l", &endpoint(service.port)];
    let mut again = Running::start("sim-server", &[&all[..], &serve].concat(), &service.folder);
    again.wait_for("as test");
    assert_eq!(page.phase("ready")["episode"], "2");

    client.signal("INT");
    let (status, text) = client.finish(PATIENCE);
    assert!(status.success(), "{status}");
    let kept: Vec<&str> = text.lines().skip(1).collect();
    assert!(matches!(kept[..], [bag] if bags.path().join(bag).display().to_string() == first), "{text}");
    assert!(client.log().contains("discarded, but still with its server: test/"), "{}", client.log());
    let found = bags.files(".mcap");
    assert!(found.len() >= 2, "{found:?}");
    for bag in found {
        let bag = fiatlux_bag::Bag::open(&bag).unwrap();
        assert!(matches!(bag.completeness(), Completeness::Whole), "{bag:?}");
        assert!(bag.header().request.as_ref().is_some_and(|request| request.take));
    }
    let args = ["grade", "--takes", "--json", &record];
    let (status, text) = Running::start("scorer", &args, &service.folder).finish(PATIENCE);
    let graded: Value = serde_json::from_str(&text).unwrap();
    let ends: Vec<&str> =
        graded["episodes"].as_array().unwrap().iter().map(|row| row["end"].as_str().unwrap()).collect();
    // The server ended one take; another was looked at and never started.
    assert_eq!((status.code(), &ends[..]), (Some(3), &["stopped"][..]), "{graded:#}");
    assert_eq!(graded["conditions"]["ranked"], false);
}

/// Who lacks the server's token opens no session; who lacks the page's sees and moves nothing.
#[test]
fn a_stranger_neither_sees_nor_drives() {
    let folder = Scratch::new("teleop-tokens");
    let keys = folder.path().join("keys").display().to_string();
    let mut made = Running::start("fiatlux", &["keys", "--out", &keys, "--name", "test"], &folder);
    assert!(made.finish(PATIENCE).0.success());
    let (tokens, token) = (format!("{keys}/server_tokens"), format!("{keys}/policy_token"));
    let service = Service::start("teleop-stranger", &["--tokens", &tokens]);
    let mut stranger = teleop(service.port, &service.folder, &[]);
    let (status, _) = stranger.finish(PATIENCE);
    assert_eq!(status.code(), Some(1));
    assert!(stranger.log().contains("holders of its tokens"), "{}", stranger.log());

    let mut client = teleop(service.port, &service.folder, &["--token", &token]);
    let url = client.wait_for("/?token=");
    let mut page = Page::open(&url);
    page.phase("ready");
    let (address, _) = url.strip_prefix("http://").and_then(|url| url.split_once('/')).unwrap();
    for path in ["/", "/document.json", "/drive", "/?token=0123456789abcdef0123456789abcdef"] {
        let mut stream = TcpStream::connect(address).unwrap();
        write!(stream, "GET {path} HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n").unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        assert!(answer.starts_with("HTTP/1.1 403"), "{path}: {answer}");
    }
    client.signal("INT");
    assert!(client.finish(PATIENCE).0.success());
}
