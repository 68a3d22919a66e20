//! Talks to doubles of model servers that use the real libraries (`tests/bridge/doubles.py`). `FIATLUX_PYTHON` names a Python with
//! the packages of `tests/bridge/requirements.txt`; without one these tests are ignored, and `tests/run` makes one.

use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use fiatlux_bridge::{
    BridgeError, Dialect, Form, Frames, Mapping, Model, ModelObservation, ModelOptions, Picture, Sensed, Tensor,
    Timeouts, check_chunk, check_contract, default_mapping,
};
use fiatlux_robot::Robot;

const DOUBLES: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/bridge/doubles.py");

fn python() -> PathBuf {
    let python =
        PathBuf::from(std::env::var_os("FIATLUX_PYTHON").expect("FIATLUX_PYTHON names a Python; tests/run makes one"));
    let status =
        Command::new(&python).args(["-c", "import zmq, msgpack, msgpack_numpy, openpi_client, websockets"]).status();
    assert!(status.is_ok_and(|status| status.success()), "it lacks packages of tests/bridge/requirements.txt");
    python
}

/// A double, which runs until it is dropped.
struct Double {
    child: Child,
    url: String,
    dialect: Dialect,
}

impl Double {
    fn start(python: &Path, dialect: Dialect, args: &[&str]) -> Self {
        let mut child = Command::new(python)
            .args([DOUBLES, "serve", "--dialect", dialect.name()])
            .args(args)
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let port: u16 = line.trim().strip_prefix("listening ").unwrap().parse().unwrap();
        let scheme = if dialect.name().starts_with("gr00t") { "tcp" } else { "ws" };
        Self { child, url: format!("{scheme}://127.0.0.1:{port}"), dialect }
    }

    fn options(&self) -> ModelOptions {
        let timeouts = Timeouts { connect: Duration::from_secs(2), reply: Duration::from_secs(5) };
        ModelOptions { url: self.url.clone(), host: None, dialect: self.dialect, timeouts, token: None }
    }

    fn model(&self) -> Box<dyn Model> {
        self.options().model().unwrap()
    }
}

impl Drop for Double {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn observed(mapping: &Mapping, robot: &Robot) -> ModelObservation {
    let q = robot.q0();
    let zeros = vec![0.0; q.len()];
    let sensed = Sensed::still(q, &zeros, 0.78);
    let mut frames = Frames::default();
    for sensor in mapping.sensors() {
        let [width, height] = mapping.picture;
        let rgb = (0..3 * width * height).map(|at| (at % 251) as u8).collect();
        frames.push(mapping, 0, sensor, Picture::new(width, height, rgb).unwrap());
    }
    mapping.observe(robot, &sensed, &frames, 0, "swap the bulb", "session-1").unwrap()
}

/// Both mappings of gr00t, and those of the other dialects.
fn cases() -> Vec<(Dialect, &'static str)> {
    let mut cases: Vec<_> = Dialect::ALL.iter().map(|(_, dialect)| (*dialect, default_mapping(*dialect))).collect();
    cases.extend([(Dialect::Gr00t, "real_g1"), (Dialect::Gr00tFlat, "real_g1")]);
    cases
}

fn start(python: &Path, dialect: Dialect, mapping: &str, args: &[&str]) -> Double {
    let embodiment = if dialect.name().starts_with("gr00t") { mapping } else { "unitree_g1" };
    Double::start(python, dialect, &[&["--embodiment", embodiment], args].concat())
}

/// Guards that the strict doubles accept our requests, byte for byte as their own libraries pack them, and that
/// contract and answer match the mapping.
#[test]
#[ignore = "needs Python's libraries: tests/run"]
fn every_dialect_is_spoken() {
    let python = python();
    let robot = Robot::benchmark().unwrap();
    for (dialect, name) in cases() {
        let double = start(&python, dialect, name, &["--navigate", "0.25,0,0.5"]);
        let mapping = Mapping::open(name, &robot).unwrap();
        let mut model = double.model();
        let contract = model.contract().unwrap_or_else(|error| panic!("{} {name}: {error}", dialect.name()));
        check_contract(&mapping, &contract).unwrap();
        model.reset().unwrap();
        let observation = observed(&mapping, &robot);
        for _ in 0..2 {
            let chunk = model.infer(&observation).unwrap_or_else(|error| panic!("{} {name}: {error}", dialect.name()));
            check_chunk(&mapping, &chunk).unwrap();
            let rows = mapping.rows(&robot, robot.q0(), &chunk).unwrap();
            assert_eq!(rows.len(), mapping.horizon);
            // The double returns the posture that it was sent.
            for (joint, target) in &rows[5].targets {
                assert!((target - robot.q0()[*joint]).abs() < 0.3, "{name}: joint {joint} goes to {target}");
            }
            let velocity = rows[0].velocity.unwrap_or([0.25, 0.0, 0.5]);
            assert_eq!(velocity, [0.25, 0.0, 0.5], "{name}");
        }
        model.reset().unwrap();
        model.infer(&observation).unwrap();
    }
}

/// Arrays of the real libraries are read, and written again with the same bytes.
#[test]
#[ignore = "needs Python's libraries: tests/run"]
fn arrays_are_byte_equal_both_ways() {
    let python = python();
    let output = Command::new(python).args([DOUBLES, "arrays"]).output().unwrap();
    assert!(output.status.success());
    let lines = String::from_utf8(output.stdout).unwrap();
    let mut count = 0;
    for line in lines.lines() {
        let line: serde_json::Value = serde_json::from_str(line).unwrap();
        let bytes = |key: &str| -> Vec<u8> {
            let text = line[key].as_str().unwrap();
            (0..text.len() / 2).map(|at| u8::from_str_radix(&text[2 * at..2 * at + 2], 16).unwrap()).collect()
        };
        let value = |bytes: &[u8]| rmpv::decode::read_value(&mut &*bytes).unwrap();
        let written = |value: &rmpv::Value| {
            let mut bytes = Vec::new();
            rmpv::encode::write_value(&mut bytes, value).unwrap();
            bytes
        };
        let gr00t = Tensor::read("it", &value(&bytes("gr00t"))).unwrap();
        let sum: f64 = gr00t.numbers().iter().filter(|number| !number.is_nan()).sum();
        let expected = line["sum"].as_f64().unwrap();
        assert!((sum - expected).abs() <= 1e-9 * expected.abs().max(1.0), "{line}");
        let shape: Vec<usize> = serde_json::from_value(line["shape"].clone()).unwrap();
        assert_eq!((gr00t.shape(), gr00t.dtype().name()), (shape.as_slice(), line["dtype"].as_str().unwrap()));
        if line["fortran"].is_null() {
            assert_eq!(written(&gr00t.write(Form::Npy)), bytes("gr00t"), "{line}");
            let openpi = Tensor::read("it", &value(&bytes("openpi"))).unwrap();
            assert_eq!(openpi, gr00t);
            assert_eq!(written(&openpi.write(Form::Openpi)), bytes("openpi"), "{line}");
        }
        count += 1;
    }
    assert_eq!(count, 64);
}

/// The golden messages are those that the installed packages make.
#[test]
#[ignore = "needs Python's libraries: tests/run"]
fn golden_messages_are_of_real_packages() {
    let python = python();
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/bridge/golden.py");
    let output = Command::new(python).arg(script).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(
        output.stdout == include_bytes!("../../src/dialect/golden.jsonl"),
        "run golden.py again, and look at what changed"
    );
}

/// Guards that faults of a server give an error with its reason, within the time-outs, and that the next request starts
/// afresh.
#[test]
#[ignore = "needs Python's libraries: tests/run"]
fn faults_are_errors_with_a_reason() {
    let python = python();
    let robot = Robot::benchmark().unwrap();
    for dialect in [Dialect::Gr00t, Dialect::Openpi, Dialect::Behavior, Dialect::Roboarena] {
        let mapping = Mapping::open(default_mapping(dialect), &robot).unwrap();
        let observation = observed(&mapping, &robot);
        for (fault, says) in [
            ("nan", "is NaN"),
            ("shape", "dimension"),
            ("error", "CUDA"),
            ("huge", "bytes; the limit is"),
            ("die", "lost"),
        ] {
            let double = Double::start(&python, dialect, &["--fault", fault, "--after", "1"]);
            let mut model = double.model();
            let check =
                |model: &mut dyn Model| model.infer(&observation).and_then(|chunk| check_chunk(&mapping, &chunk));
            check(model.as_mut()).unwrap();
            let start = Instant::now();
            let error = check(model.as_mut()).unwrap_err();
            assert!(error.to_string().contains(says), "{} {fault}: {error}", dialect.name());
            assert!(start.elapsed() < Duration::from_secs(6), "{} {fault}", dialect.name());
            assert_eq!(error.is_transient(), fault == "die", "{} {fault}", dialect.name());
            if fault == "die" {
                let again = check(model.as_mut()).unwrap_err();
                assert!(again.is_transient(), "{again}");
            }
        }
        // A slow server is not an error within the time-out; below it, it is one, and the next question gets its own
        // answer.
        let double = Double::start(&python, dialect, &["--delay", "1"]);
        double.model().infer(&observation).unwrap();
        let timeouts = Timeouts { reply: Duration::from_millis(300), ..Timeouts::default() };
        let mut hasty = ModelOptions { timeouts, ..double.options() }.model().unwrap();
        let error = hasty.infer(&observation).unwrap_err();
        assert!(matches!(error, BridgeError::Timeout { .. }) && error.is_transient(), "{error}");
        check_chunk(&mapping, &double.model().infer(&observation).unwrap()).unwrap();
    }
}

/// API tokens and keys are sent to servers that need them.
#[test]
#[ignore = "needs Python's libraries: tests/run"]
fn tokens_are_sent() {
    let python = python();
    for (dialect, flag) in [(Dialect::Gr00t, "--token"), (Dialect::Openpi, "--key")] {
        let double = Double::start(&python, dialect, &[flag, "s3cret"]);
        assert!(double.model().contract().is_err());
        let known = ModelOptions { token: Some("s3cret".into()), ..double.options() };
        known.model().unwrap().contract().unwrap();
    }
}
