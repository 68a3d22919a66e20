//! The policy `vla` over real processes: a double of a model server in Python (`tests/bridge/doubles.py`), a simulation server,
//! a policy client, and what the bag says. It runs where `FIATLUX_PYTHON` names a Python with the packages of
//! `tests/bridge/requirements.txt`.
#![allow(clippy::unwrap_used)]

use std::io::{BufRead, BufReader};
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};

use fiatlux_bag::Bag;
use fiatlux_proto::v3::Chunk;
use fiatlux_tests::programs::{PATIENCE, Running, Scratch, Service, wait_until};

const DOUBLES: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/bridge/doubles.py");

fn python() -> Option<PathBuf> {
    let python = PathBuf::from(std::env::var_os("FIATLUX_PYTHON")?);
    let imports = ["-c", "import zmq, msgpack, openpi_client, websockets"];
    let status = Command::new(&python).args(imports).stderr(Stdio::null()).status();
    status.is_ok_and(|status| status.success()).then_some(python)
}

/// A double that runs until it is dropped.
struct Double(Child, String);

impl Double {
    fn start(python: &PathBuf, dialect: &str, args: &[&str]) -> Self {
        let mut command = Command::new(python);
        command.args([DOUBLES, "serve", "--dialect", dialect]).args(args);
        let mut child = command.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let port = line.trim().strip_prefix("listening ").unwrap();
        let scheme = if dialect.starts_with("gr00t") { "tcp" } else { "ws" };
        Self(child, format!("{scheme}://127.0.0.1:{port}"))
    }
}

impl Drop for Double {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Plays against a double; the log of the client, and where its actions come from by the bag.
fn play(python: &PathBuf, dialect: &str, double: &[&str], args: &[&str]) -> (String, Vec<Chunk>) {
    let double = Double::start(python, dialect, double);
    let folder = Scratch::new("bags");
    let bags = folder.path().display().to_string();
    let service = Service::start("bridge", &["--record", &bags]);
    let all =
        [&["--policy", "vla", "--dialect", dialect, "--model", &double.1, "--model-patience", "1"], args].concat();
    let mut client = service.client(&[&all[..], &["--task", "S07"]].concat());
    let (status, _) = client.finish(PATIENCE);
    assert!(!status.success(), "the double has a fault");
    let log = client.log();
    // The server ends the bag when the session is closed.
    wait_until("a bag", PATIENCE, || !folder.files(".mcap").is_empty());
    drop(service);
    let bag = folder.files(".mcap");
    let bag = Bag::open(bag.first().unwrap_or_else(|| panic!("no bag; {log}"))).unwrap();
    assert!(bag.header().policy.starts_with(&format!("vla:{dialect}:")), "{}", bag.header().policy);
    let chunks = bag.actions().map(|action| action.unwrap().action.unwrap().chunk.expect("each has a chunk")).collect();
    (log, chunks)
}

/// Guards that the bag has each chunk once with its latency, where every action comes from, and at the end what happened.
#[test]
fn the_bag_has_every_chunk_and_what_went_wrong() {
    let Some(python) = python() else {
        return eprintln!("skipped: FIATLUX_PYTHON names no Python with the packages of tests/bridge/requirements.txt");
    };
    for (dialect, map, width, rows, prefix) in
        [("gr00t", "real_g1", 53, 40, 10), ("openpi", "openpi_g1", 23, 50, 10), ("behavior", "behavior_g1", 23, 16, 4)]
    {
        let steps_per_row = if dialect == "behavior" { 2 } else { 1 };
        let double = [
            "--fault",
            "die",
            "--after",
            "2",
            "--delay",
            "0.05",
            "--embodiment",
            if dialect == "gr00t" { map } else { "unitree_g1" },
        ];
        let (log, chunks) = play(&python, dialect, &double, &["--map", map, "--prefix", &prefix.to_string()]);
        assert!(log.contains("policy vla cannot go on"), "{log}");
        let steps = 2 * prefix * steps_per_row;
        assert_eq!(chunks.len(), steps + 1, "{dialect}: two prefixes, and the action that says what happened");
        for (step, chunk) in chunks[..steps].iter().enumerate() {
            let begins = step % (prefix * steps_per_row);
            assert_eq!(
                (chunk.index as usize, chunk.row as usize),
                (step / (prefix * steps_per_row), begins / steps_per_row)
            );
            assert!((chunk.age_s - 0.02 * begins as f64).abs() < 1e-9);
            let is_new = begins == 0;
            assert_eq!(chunk.values.len(), if is_new { rows * width } else { 0 }, "{dialect} step {step}");
            assert_eq!(is_new, chunk.latency_s > 0.05);
            assert_eq!(chunk.problem, "");
        }
        let last = chunks.last().unwrap();
        assert!(last.problem.starts_with("the policy gives up: "), "{}", last.problem);
    }
}

/// Numbers that are not finite are never played.
#[test]
fn spoiled_answers_end_the_episode_with_a_reason() {
    let Some(python) = python() else {
        return eprintln!("skipped: FIATLUX_PYTHON names no Python with the packages of tests/bridge/requirements.txt");
    };
    for (fault, says) in [("nan", "is NaN"), ("shape", "dimension"), ("error", "CUDA"), ("huge", "at most")] {
        let (log, chunks) = play(&python, "gr00t", &["--fault", fault, "--after", "1"], &["--prefix", "5"]);
        assert!(log.contains(says), "{fault}: {log}");
        assert_eq!(chunks.len(), 6);
        assert!(chunks[5].problem.contains(says), "{fault}: {}", chunks[5].problem);
    }
}

/// A mapping that does not fit, or a server that is not there, is told of before a session is opened.
#[test]
fn nothing_is_opened_where_something_does_not_fit() {
    let Some(python) = python() else {
        return eprintln!("skipped: FIATLUX_PYTHON names no Python with the packages of tests/bridge/requirements.txt");
    };
    let folder = Scratch::new("unfit");
    let run = |url: &str, map: &str, dialect: &str| {
        let args = ["run", "--policy", "vla", "--dialect", dialect, "--model", url, "--map", map, "--task", "S07"];
        let mut client = Running::start("policy-client", &args, &folder);
        let (status, _) = client.finish(PATIENCE);
        assert!(!status.success());
        client.log()
    };
    let double = Double::start(&python, "gr00t", &[]);
    let log = run(&double.1, "real_g1", "gr00t");
    for says in ["left_wrist_eef_9d", "frames 'ego_view'", "horizon"] {
        assert!(log.contains(says), "{says}: {log}");
    }
    let log = run(&double.1, "unitree_g1_sonic", "gr00t-sonic");
    assert!(log.contains("994 inputs"), "{log}");
    let url = double.1.clone();
    drop(double);
    let log = run(&url, "unitree_g1", "gr00t");
    assert!(log.contains("cannot connect to the model server"), "{log}");
    let double = Double::start(&python, "gr00t", &["--delay", "0.02"]);
    let mut probe = Running::start("policy-client", &["probe", "--dialect", "gr00t", "--model", &double.1], &folder);
    let (status, text) = probe.finish(PATIENCE);
    assert!(status.success(), "{text}\n{}", probe.log());
    for says in ["camera 'ego_view', frames [0]", "[1, 480, 640, 3]", "navigate_command 30 x 3", "latency"] {
        assert!(text.contains(says), "{says}: {text}");
    }
}
