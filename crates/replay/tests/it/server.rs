//! The server of replays over real sockets.

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use fiatlux_replay::{Bags, Replay, ReplayError, Viewer};
use fiatlux_rules::Task;

use crate::common::play;

struct Serving {
    address: SocketAddr,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<Result<(), ReplayError>>>,
}

impl Serving {
    fn start(bags: Bags) -> Self {
        let viewer = Viewer::bind(bags, 0).unwrap();
        let (address, stop) = (viewer.address(), Arc::new(AtomicBool::new(false)));
        let flag = Arc::clone(&stop);
        Self { address, stop, thread: Some(std::thread::spawn(move || viewer.serve(&flag))) }
    }

    /// Sends a request, and returns status, head and body of the answer.
    fn ask(&self, method: &str, path: &str, host: &str) -> (u16, String, Vec<u8>) {
        let mut stream = TcpStream::connect(self.address).unwrap();
        write!(stream, "{method} {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n").unwrap();
        let mut answer = Vec::new();
        stream.read_to_end(&mut answer).unwrap();
        let end = answer.windows(4).position(|window| window == b"\r\n\r\n").unwrap();
        let head = String::from_utf8(answer[..end].to_vec()).unwrap().to_lowercase();
        let status = head.split_whitespace().nth(1).unwrap().parse().unwrap();
        (status, head, answer[end + 4..].to_vec())
    }

    fn get(&self, path: &str) -> (u16, String, Vec<u8>) {
        self.ask("GET", path, &self.address.to_string())
    }
}

impl Drop for Serving {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        self.thread.take().unwrap().join().unwrap().unwrap();
    }
}

#[test]
fn one_bag_is_served_with_all_its_parts() {
    let played = play("served", Task::S05, 8);
    let replay = Replay::open(&played.bag).unwrap();
    let serving = Serving::start(Bags::find(&played.bag).unwrap());
    assert!(serving.address.ip().is_loopback());
    let (status, head, _) = serving.get("/");
    assert_eq!((status, head.contains("location: /episode/0")), (307, true));
    let (status, head, page) = serving.get("/episode/0");
    assert_eq!(status, 200);
    let policy = head.lines().find(|line| line.starts_with("content-security-policy:")).unwrap();
    assert!(policy.contains("default-src 'none'") && policy.contains("connect-src 'self'"), "{policy}");
    assert!(!policy.contains("unsafe") && !policy.contains("http"), "{policy}");
    let page = String::from_utf8(page).unwrap();
    assert!(!page.contains("<!--") && !page.contains("All episodes"));
    assert_eq!(serving.get("/episode/0/document.json").2, replay.document_json().as_bytes());
    assert_eq!(serving.get("/episode/0/meshes.bin").2, replay.meshes());
    assert_eq!(serving.get("/episode/0/track.bin").2, replay.track());
    assert_eq!(serving.get("/episode/0/pictures.bin").2, replay.pictures());
    let (status, head, bag) = serving.get("/episode/0/bag");
    assert_eq!(status, 200);
    assert!(head.contains("content-disposition: attachment; filename=\"s05.mcap\""), "{head}");
    assert_eq!(bag, std::fs::read(&played.bag).unwrap());
    // Everything that the page links to exists.
    for file in page.split("/page/").skip(1).filter_map(|rest| rest.split('"').next()) {
        assert_eq!(serving.get(&format!("/page/{file}")).0, 200, "{file}");
    }
    assert_eq!(serving.ask("HEAD", "/episode/0", &serving.address.to_string()).2, Vec::<u8>::new());
}

#[test]
fn a_folder_is_listed_and_a_broken_bag_says_why() {
    let played = play("listed", Task::S07, 8);
    std::fs::write(played.folder.join("A broken one.mcap"), "no bag").unwrap();
    let serving = Serving::start(Bags::find(&played.folder).unwrap());
    let (status, _, page) = serving.get("/");
    assert!(status == 200 && String::from_utf8(page).unwrap().contains("Replays"));
    let list: serde_json::Value = serde_json::from_slice(&serving.get("/episodes.json").2).unwrap();
    let entries = list["entries"].as_array().unwrap();
    assert_eq!(entries.len(), 2);
    assert!(entries[0]["error"].as_str().unwrap().contains("A broken one.mcap"));
    assert_eq!((&entries[1]["title"], &entries[1]["policy"]), (&"S07 Approach New Bulb".into(), &"restless".into()));
    assert_eq!(entries[1]["strict"]["cause"], played.cause);
    let (status, _, why) = serving.get("/episode/0/document.json");
    assert_eq!(status, 422);
    assert!(String::from_utf8(why).unwrap().contains("name an .mcap file that a recorder wrote"));
    assert!(String::from_utf8(serving.get("/episode/1").2).unwrap().contains("All episodes"));
    // A missing bag gives an error answer, and the server continues.
    std::fs::remove_file(&played.bag).unwrap();
    assert_eq!(serving.get("/episode/1/track.bin").0, 422);
    assert_eq!(serving.get("/episode/1/bag").0, 404);
}

/// Guards that a client's path never becomes a path of a file, and that pages of other hosts cannot read.
#[test]
fn paths_and_hosts_that_are_not_ours_are_refused() {
    let played = play("refused", Task::S05, 9);
    let serving = Serving::start(Bags::find(&played.bag).unwrap());
    for path in [
        "/episode/1",
        "/episode/-1",
        "/episode/+0",
        "/episode/0x0",
        "/episode/99999999999999999999999999",
        "/episode/..%2f..%2fetc%2fpasswd/bag",
        "/episode/../../etc/passwd",
        "/episode//bag",
        "/page/../../Cargo.toml",
        "/page/..%2f..%2fCargo.toml",
        "/page/%00",
        "/etc/passwd",
        "/episode/0/bag/x",
    ] {
        let (status, head, body) = serving.get(path);
        assert_eq!(status, 404, "{path}: {}", String::from_utf8_lossy(&body));
        assert!(head.contains("nosniff") && head.contains("content-security-policy: default-src 'none'"), "{head}");
    }
    let port = serving.address.port();
    for host in ["example.org", &format!("example.org:{port}"), "localhost.example.org", ""] {
        assert_eq!(serving.ask("GET", "/episode/0/document.json", host).0, 421, "{host}");
    }
    // A tunnel listens on another port.
    for host in [&format!("localhost:{port}"), "localhost:9000", "127.0.0.1:1", "127.0.0.1", "[::1]:9000"] {
        assert_eq!(serving.ask("GET", "/episode/0", host).0, 200, "{host}");
    }
    for method in ["POST", "PUT", "DELETE"] {
        assert_eq!(serving.ask(method, "/episode/0", &serving.address.to_string()).0, 405, "{method}");
    }
}

/// Guards downloads that go on, and readers that ask for parts of a bag.
#[test]
fn a_bag_is_sent_in_parts() {
    let played = play("parts", Task::S05, 8);
    let whole = std::fs::read(&played.bag).unwrap();
    let serving = Serving::start(Bags::find(&played.bag).unwrap());
    let ask = |method: &str, headers: &str| {
        let host = format!("{}\r\n{headers}", serving.address);
        serving.ask(method, "/episode/0/bag", host.trim_end())
    };
    let (status, head, _) = ask("GET", "");
    assert!(status == 200 && head.contains("accept-ranges: bytes"), "{head}");
    let tag = head.lines().find_map(|line| line.strip_prefix("etag: ")).unwrap().to_owned();
    let (status, head, part) = ask("GET", "Range: bytes=0-99");
    assert_eq!((status, &part[..]), (206, &whole[..100]));
    assert!(head.contains(&format!("content-range: bytes 0-99/{}", whole.len())), "{head}");
    assert!(head.contains("content-length: 100\r\n"), "{head}");
    // More than fits into a block.
    let (status, _, rest) = ask("GET", &format!("Range: bytes=1000-\r\nIf-Range: {tag}"));
    assert!(whole.len() > 1000 + (64 << 10), "the bag is too small for this test: {} bytes", whole.len());
    assert!(status == 206 && rest == whole[1000..]);
    let (status, _, all) = ask("GET", "Range: bytes=1000-\r\nIf-Range: \"another\"");
    assert!(status == 200 && all == whole);
    let (status, head, _) = ask("GET", &format!("Range: bytes={}-", whole.len()));
    assert!(status == 416 && head.contains(&format!("content-range: bytes */{}", whole.len())), "{head}");
    assert_eq!(ask("GET", &format!("If-None-Match: \"x\", W/{tag}")).0, 304);
    let (status, head, body) = ask("HEAD", "Range: bytes=0-99");
    assert!(status == 200 && head.contains(&format!("content-length: {}", whole.len())), "{head}");
    assert!(body.is_empty());
}

#[test]
fn silent_connections_end_and_keep_nobody_out() {
    let played = play("silent", Task::S05, 9);
    let serving = Serving::start(Bags::find(&played.bag).unwrap());
    let mut silent: Vec<TcpStream> = (0..300).map(|_| TcpStream::connect(serving.address).unwrap()).collect();
    assert_eq!(serving.get("/episode/0").0, 200);
    for stream in &mut silent {
        stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
        assert!(matches!(stream.read(&mut [0]), Ok(0) | Err(_)));
        assert!(stream.write(&[0]).is_err() || stream.read(&mut [0]).is_ok_and(|length| length == 0), "it is open");
    }
}

#[test]
fn a_port_that_is_taken_is_said() {
    let played = play("taken", Task::S05, 9);
    let bags = Bags::find(&played.bag).unwrap();
    let first = Viewer::bind(bags.clone(), 0).unwrap();
    let said = Viewer::bind(bags, first.address().port()).unwrap_err().to_string();
    assert!(said.contains("choose another port with --port"), "{said}");
}

/// Guards that a browser gets compressed parts, and that they decompress to the same bytes.
#[test]
fn parts_are_sent_packed_to_who_takes_gzip() {
    let played = play("packed", Task::S05, 8);
    let replay = Replay::open(&played.bag).unwrap();
    let serving = Serving::start(Bags::find(&played.bag).unwrap());
    assert_eq!(serving.get("/episode/0/joints.bin").2, replay.joints());
    assert_eq!(replay.joints().len(), 4 * 2 * replay.document().track.joints.len() * replay.document().track.kept);
    // The robot's shapes have one address in all episodes, and the browser may keep them.
    for block in &replay.document().stage.blocks {
        let (status, head, bytes) = serving.get(&format!("/shapes/{}", block.digest));
        assert_eq!((status, bytes.len()), (200, 4 * (6 * block.vertices + block.indices)));
        assert!(head.contains("immutable"), "{head}");
    }
    let other = Replay::open(&play("other-room", Task::S07, 9).bag).unwrap();
    let digests = |replay: &Replay| replay.document().stage.blocks.clone().map(|block| block.digest);
    assert!(digests(&other)[0] == digests(&replay)[0] && digests(&other)[1] != digests(&replay)[1]);
    assert_eq!(serving.get("/shapes/00").0, 404);
    let request = format!(
        "GET /episode/0/meshes.bin HTTP/1.1\r\nHost: {}\r\nAccept-Encoding: gzip, br\r\nConnection: close\r\n\r\n",
        serving.address
    );
    let mut stream = TcpStream::connect(serving.address).unwrap();
    stream.write_all(request.as_bytes()).unwrap();
    let mut answer = Vec::new();
    stream.read_to_end(&mut answer).unwrap();
    let head = String::from_utf8_lossy(&answer[..answer.len().min(600)]).to_ascii_lowercase();
    assert!(head.contains("content-encoding: gzip") && head.contains("vary: accept-encoding"), "{head}");
    assert!(2 * answer.len() < replay.meshes().len(), "{} of {}", answer.len(), replay.meshes().len());
}
