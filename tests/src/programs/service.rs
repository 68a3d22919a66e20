//! A server with what belongs to it: its recorder, its clients, its bags.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{self, Receiver};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use fiatlux_access::RecorderKey;
use fiatlux_proto::Message;
use fiatlux_proto::keys::{ROOT, SessionKeys};
use fiatlux_proto::v3::Observation;
use serde_json::Value;
use zenoh::{Config, Session, Wait};

use super::{PATIENCE, Running, Scratch, free_port};

/// A server of a test's own, named `test`, on a port of its own.
#[derive(Debug)]
pub struct Service {
    /// The process of the server.
    pub server: Running,
    /// The port that clients connect to.
    pub port: u16,
    /// Logs, and bags in `bags`. Dropped last.
    pub folder: Scratch,
}

impl Service {
    /// Starts a server with these options more, and waits until it can be found.
    pub fn start(name: &str, args: &[&str]) -> Self {
        let folder = Scratch::new(name);
        let key = recorder_key(&folder);
        let key = key.display().to_string();
        let mut all = vec!["--name", "test", "-l", "tcp/127.0.0.1:0"];
        all.extend(args);
        if !args.contains(&"--record") {
            all.extend(["--recorder-key", &key]);
        }
        let mut server = Running::start("sim-server", &all, &folder);
        let line = server.wait_for("listening on tcp/127.0.0.1:");
        let port = line.split(':').nth(1).and_then(|rest| rest.split(' ').next()).and_then(|port| port.parse().ok());
        let port = port.unwrap_or_else(|| panic!("no port in '{line}'"));
        Self { server, port, folder }
    }

    /// Starts a router and a server behind it; the port is the router's.
    pub fn start_behind_router(name: &str) -> (Self, Running) {
        let folder = Scratch::new(name);
        let port = free_port();
        let router = router(port, &folder);
        let key = recorder_key(&folder).display().to_string();
        let mut server =
            Running::start("sim-server", &["--name", "test", "-e", &endpoint(port), "--recorder-key", &key], &folder);
        server.wait_for("connected to tcp/127.0.0.1:");
        (Self { server, port, folder }, router)
    }

    /// Folder of the bags.
    pub fn bags(&self) -> PathBuf {
        self.folder.path().join("bags")
    }

    /// The key that the server and its recorders have.
    pub fn recorder_key(&self) -> PathBuf {
        recorder_key(&self.folder)
    }

    /// A recorder of this server.
    pub fn record(&self) -> Running {
        record(self.port, &self.folder)
    }

    /// As [`Service::record`]; the system lets it write no file of more than that many times 512 bytes.
    pub fn record_limited(&self, blocks: u32) -> Running {
        let args = recorder_args(self.port, &self.folder);
        Running::start_limited("recorder", &args.each_ref().map(String::as_str), &self.folder, blocks)
    }

    /// A policy client of this server: `run --json` with these options.
    pub fn client(&self, args: &[&str]) -> Running {
        client(self.port, args, &self.folder)
    }

    /// Plays with a policy client to the end.
    pub fn play(&self, args: &[&str]) -> Vec<Played> {
        played(&mut self.client(args))
    }
}

/// The endpoint of a port on this machine, `tcp/127.0.0.1:PORT`.
pub fn endpoint(port: u16) -> String {
    format!("tcp/127.0.0.1:{port}")
}

pub fn router(port: u16, folder: &Scratch) -> Running {
    let mut router = Running::start("examples/router", &[&port.to_string()], folder);
    router.wait_for("ready");
    router
}

/// The file of a folder's recorder key; made where there is none.
fn recorder_key(folder: &Scratch) -> PathBuf {
    let path = folder.path().join("recorder.key");
    if !path.exists() {
        RecorderKey::generate().unwrap().write(&path).unwrap();
    }
    path
}

/// A recorder that connects to that port; its bags go to `bags` in the folder.
pub fn record(port: u16, folder: &Scratch) -> Running {
    Running::start("recorder", &recorder_args(port, folder).each_ref().map(String::as_str), folder)
}

fn recorder_args(port: u16, folder: &Scratch) -> [String; 6] {
    let path = |path: PathBuf| path.display().to_string();
    let (bags, key) = (path(folder.path().join("bags")), path(recorder_key(folder)));
    ["--out".into(), bags, "--recorder-key".into(), key, "-e".into(), endpoint(port)]
}

/// A policy client that connects to that port: `run --json` with these options.
pub fn client(port: u16, args: &[&str], folder: &Scratch) -> Running {
    let endpoint = endpoint(port);
    let mut all = vec!["run", "--json", "-e", &endpoint];
    all.extend(args);
    Running::start("policy-client", &all, folder)
}

/// The end of an episode, as the policy client prints it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Played {
    /// Such as `time-out`.
    pub cause: String,
    pub steps: u64,
    pub digest: String,
    /// The digest is that of the bag that was replayed.
    pub is_equal: Option<bool>,
}

/// The episodes of a policy client that has to end well.
pub fn played(client: &mut Running) -> Vec<Played> {
    let (status, text) = client.finish(PATIENCE);
    assert!(status.success(), "{status}; log:\n{}", client.log());
    let report: Value = serde_json::from_str(&text).unwrap();
    let episode = |episode: &Value| Played {
        cause: episode["cause"].as_str().unwrap().into(),
        steps: episode["steps"].as_u64().unwrap(),
        digest: episode["digest"].as_str().unwrap().into(),
        is_equal: episode["digest_equal"].as_bool(),
    };
    report["episodes"].as_array().unwrap().iter().map(episode).collect()
}

/// The episode of these options without disturbance: on a server without any other client or recorder. Played once for
/// all tests of a process.
pub fn alone(args: &[&str]) -> Vec<Played> {
    static KNOWN: Mutex<BTreeMap<String, Vec<Played>>> = Mutex::new(BTreeMap::new());
    let mut known = KNOWN.lock().unwrap_or_else(PoisonError::into_inner);
    known.entry(args.join(" ")).or_insert_with(|| Service::start("alone", &[]).play(args)).clone()
}

/// `scorer grade --json` over what is in a folder: its exit code and its results.
pub fn grade(bags: &Path, folder: &Scratch) -> (i32, Value) {
    let mut scorer = Running::start("scorer", &["grade", "--json", &bags.display().to_string()], folder);
    let (status, text) = scorer.finish(PATIENCE);
    let results = serde_json::from_str(&text);
    (status.code().unwrap(), results.unwrap_or_else(|error| panic!("{error}; log:\n{}", scorer.log())))
}

/// A client of a server's network that says only what a test tells it to.
pub fn connect(port: u16) -> Session {
    let mut config = Config::default();
    for (key, value) in [
        ("mode", "\"client\"".to_string()),
        ("scouting/multicast/enabled", "false".into()),
        ("connect/endpoints", format!("[\"{}\"]", endpoint(port))),
        ("connect/timeout_ms", "5000".into()),
    ] {
        config.insert_json5(key, &value).unwrap();
    }
    zenoh::open(config).wait().unwrap()
}

/// Watches how far sessions are.
pub struct Watch {
    observations: Receiver<(String, u64)>,
    _link: Session,
}

impl Watch {
    /// Watches all sessions that are played from now on, on the network that is reached at that port.
    pub fn start(port: u16) -> Self {
        let link = connect(port);
        let (sender, observations) = mpsc::channel();
        let subscriber = link.declare_subscriber(format!("{ROOT}/*/s/*/observation")).callback(move |sample| {
            let key = sample.key_expr().as_str();
            let observation = Observation::decode(&*sample.payload().to_bytes());
            if let (Some((_, _, session)), Ok(observation)) = (SessionKeys::of(key), observation) {
                drop(sender.send((session.to_owned(), observation.step)));
            }
        });
        subscriber.background().wait().unwrap();
        Self { observations, _link: link }
    }

    /// Waits until some session is at that step or beyond; returns its id.
    pub fn wait_for(&self, step: u64) -> String {
        let until = Instant::now() + PATIENCE;
        loop {
            let left = until.saturating_duration_since(Instant::now());
            match self.observations.recv_timeout(left) {
                Ok((session, at)) if at >= step => return session,
                Ok(_) => {}
                Err(error) => panic!("no session came to step {step}: {error}"),
            }
        }
    }
}

/// Waits until something is so.
///
/// # Panics
/// Where it does not become so.
pub fn wait_until(what: &str, patience: Duration, is_so: impl Fn() -> bool) {
    let start = Instant::now();
    while !is_so() {
        assert!(start.elapsed() < patience, "after {patience:?} it is not so: {what}");
        std::thread::sleep(Duration::from_millis(10));
    }
}
