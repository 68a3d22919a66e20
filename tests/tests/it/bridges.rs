//! The policy `vla` over real processes: a double of a model server in Python (`tests/bridge/doubles.py`), a simulation server,
//! a policy client, and what the bag says. `FIATLUX_PYTHON` names a Python with the packages of
//! `tests/bridge/requirements.txt`.

use std::collections::BTreeMap;
use std::io::{BufRead, BufReader, Write};
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};

use fiatlux_bag::Bag;
use fiatlux_proto::v3::{Action, Chunk};
use fiatlux_tests::programs::{PATIENCE, Running, Scratch, Service, wait_until};

const DOUBLES: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/bridge/doubles.py");

/// Our networks of other controllers' shapes, and what Python makes of them.
const NETWORKS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../crates/foreign/tests/fixtures");
const REFERENCE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/oracle/foreign.py");

fn python() -> PathBuf {
    python_with("zmq, msgpack, openpi_client, websockets")
}

fn python_with(packages: &str) -> PathBuf {
    let python =
        PathBuf::from(std::env::var_os("FIATLUX_PYTHON").expect("FIATLUX_PYTHON names a Python; tests/run makes one"));
    let imports = ["-c", &format!("import {packages}")];
    let status = Command::new(&python).args(imports).status();
    assert!(status.is_ok_and(|status| status.success()), "it lacks some of {packages}");
    python
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

/// Output of a run against a double.
struct Recorded {
    /// The client's stderr.
    log: String,
    bag: Bag,
    actions: Vec<Action>,
    /// Last, so that the bag is there as long as this.
    _folder: Scratch,
}

/// The doubles count their answers, so the policy asks nothing before the episode.
const NO_WARM_UP: &[&str] = &["--warm-up-timeout", "0"];

/// Plays against a double.
fn record(python: &PathBuf, dialect: &str, double: &[&str], args: &[&str]) -> Recorded {
    let double = Double::start(python, dialect, double);
    let folder = Scratch::new("bags");
    let bags = folder.path().display().to_string();
    let service = Service::start("bridge", &["--record", &bags]);
    let all =
        [&["--policy", "vla", "--dialect", dialect, "--model", &double.1, "--model-patience", "1"], NO_WARM_UP, args]
            .concat();
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
    // In real time a row that no action reached has the last one again.
    let came = bag.actions().map(Result::unwrap).filter(|record| !record.held);
    let actions = came.filter_map(|record| record.action).collect();
    Recorded { log, bag, actions, _folder: folder }
}

/// The log of the client, and where its actions come from by the bag.
fn play(python: &PathBuf, dialect: &str, double: &[&str], args: &[&str]) -> (String, Vec<Chunk>) {
    let recorded = record(python, dialect, double, args);
    let chunks = recorded.actions.into_iter().map(|action| action.chunk.expect("each has a chunk")).collect();
    (recorded.log, chunks)
}

/// A chunk as the bag has it.
struct PlayedChunk {
    /// Steps of its question and of the first action that plays it.
    observed: u64,
    arrived: u64,
    latency_s: f64,
    keys: Vec<String>,
    width: usize,
    values: Vec<f32>,
}

impl PlayedChunk {
    /// Of an action in which a chunk is first played.
    fn of(step: u64, chunk: &Chunk) -> Self {
        let observed = step - (chunk.age_s / 0.02).round() as u64;
        let (latency_s, width) = (chunk.latency_s, chunk.width as usize);
        Self { observed, arrived: step, latency_s, keys: chunk.keys.clone(), width, values: chunk.values.clone() }
    }

    /// The numbers of a key in a row; the last row holds on.
    fn numbers(&self, row: usize, key: &str) -> &[f32] {
        let widths = self.keys.iter().map(|key| key.rsplit_once(':').unwrap().1.parse::<usize>().unwrap());
        let at = self.keys.iter().position(|known| known.split(':').next() == Some(key)).expect(key);
        let (from, width) = (widths.clone().take(at).sum::<usize>(), widths.clone().nth(at).unwrap());
        let row = row.min(self.values.len() / self.width - 1);
        &self.values[row * self.width + from..][..width]
    }
}

/// Guards that the bag has each chunk once with its latency, where every action comes from, and at the end what happened.
#[test]
#[ignore = "needs Python's libraries: tests/run"]
fn the_bag_has_every_chunk_and_what_went_wrong() {
    let python = python();
    for (dialect, map, hands, width, rows, prefix) in [
        ("gr00t", "real_g1", "dex3", 53, 40, 10),
        ("openpi", "openpi_g1", "inspire", 23, 50, 10),
        ("behavior", "behavior_g1", "inspire", 23, 16, 4),
    ] {
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
        let (log, chunks) =
            play(&python, dialect, &double, &["--map", map, "--hands", hands, "--prefix", &prefix.to_string()]);
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
        assert!(last.problem.starts_with("the policy cannot go on: "), "{}", last.problem);
    }
}

/// Numbers that are not finite are never played.
#[test]
#[ignore = "needs Python's libraries: tests/run"]
fn spoiled_answers_end_the_episode_with_a_reason() {
    let python = python();
    for (fault, says) in [("nan", "is NaN"), ("shape", "dimension"), ("error", "CUDA"), ("huge", "the limit is")] {
        let (log, chunks) = play(&python, "gr00t", &["--fault", fault, "--after", "1"], &["--prefix", "5"]);
        assert!(log.contains(says), "{fault}: {log}");
        assert_eq!(chunks.len(), 6);
        assert!(chunks[5].problem.contains(says), "{fault}: {}", chunks[5].problem);
    }
}

/// A mapping that does not fit, or a server that is not there, is told of before a session is opened.
#[test]
#[ignore = "needs Python's libraries: tests/run"]
fn nothing_is_opened_where_something_does_not_fit() {
    let python = python();
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

/// Motion tokens through the decoder of SONIC, and commands through GEAR's controller: the targets that went over the network
/// are those that Python makes of the same networks, of what the robot sensed and of what the model said, all by the bag.
#[test]
#[ignore = "needs Python's libraries: tests/run"]
fn foreign_controllers_carry_what_a_model_says() {
    let python = python_with("zmq, msgpack, openpi_client, websockets, onnx, onnxruntime");
    for (dialect, map, player, controller, gains, moved) in [
        ("gr00t-sonic", "unitree_g1_sonic", "sonic", format!("sonic:{NETWORKS}"), "sonic", 29),
        ("gr00t", "unitree_g1", "gear.nvidia", format!("gear:{NETWORKS}"), "gear", 15),
        ("gr00t", "unitree_g1", "gear.lerobot", format!("gear:{NETWORKS},reading=lerobot"), "gear-lerobot", 15),
    ] {
        let double = ["--embodiment", map, "--fault", "die", "--after", "3", "--navigate", "0.3,-0.1,0.2"];
        let args = ["--controller", &controller, "--gains", gains, "--prefix", "8", "--end-on", "time-out"];
        let recorded = record(&python, dialect, &double, &args);
        // The controllers have the names of their gains.
        assert!(recorded.bag.header().policy.ends_with(&format!(":{gains}")), "{}", recorded.bag.header().policy);
        assert_eq!(recorded.actions.len(), 25, "{player}: three prefixes, and the action that says what happened");
        let (mut known, mut seen) = (None::<PlayedChunk>, Vec::new());
        for (action, observation) in recorded.actions.iter().zip(recorded.bag.observations()) {
            let (chunk, observation) = (action.chunk.as_ref().unwrap(), observation.unwrap());
            assert_eq!(action.step, observation.step);
            if !chunk.values.is_empty() {
                known = Some(PlayedChunk::of(action.step, chunk));
            }
            let said = |key| known.as_ref().unwrap().numbers(chunk.row as usize, key).to_vec();
            let body = observation.proprioception.unwrap();
            let mut step = serde_json::json!({
                "angular_velocity": body.base_angular_velocity,
                "gravity": body.projected_gravity,
                "position": body.joint_position[..29],
                "velocity": body.joint_velocity[..29],
            });
            let own = step.as_object_mut().unwrap();
            if player == "sonic" {
                own.insert("token".into(), said("motion_token").into());
            } else {
                own.insert("command".into(), said("navigate_command").into());
                own.insert("height".into(), said("base_height_command")[0].into());
                own.insert("waist".into(), said("waist").into());
            }
            seen.push(step);
        }
        let mut reference = Command::new(&python)
            .args([REFERENCE, NETWORKS, "--play", player])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        reference.stdin.take().unwrap().write_all(&serde_json::to_vec(&seen).unwrap()).unwrap();
        let said = reference.wait_with_output().unwrap();
        assert!(said.status.success());
        let targets: Vec<Vec<f64>> = serde_json::from_slice(&said.stdout).unwrap();
        let mut farthest = 0.0_f64;
        for (action, targets) in recorded.actions.iter().zip(&targets) {
            assert_eq!(targets.len(), moved);
            for (joint, (ours, theirs)) in action.joint_target.iter().zip(targets).enumerate() {
                farthest = farthest.max((ours - theirs).abs());
                assert!((ours - theirs).abs() < 1e-5, "{player} step {} joint {joint}: {ours}, {theirs}", action.step);
            }
        }
        println!("{player}: {} steps, farthest {farthest:.1e} rad", targets.len());
    }
}

/// A token beyond the decoder's limit is refused before anything of its chunk is played, and a session of other gains is not
/// played at all.
#[test]
#[ignore = "needs Python's libraries: tests/run"]
fn tokens_and_gains_that_do_not_fit_are_refused() {
    let python = python();
    let controller = format!("sonic:{NETWORKS}");
    let double = ["--embodiment", "unitree_g1_sonic", "--fault", "token", "--after", "1"];
    let args = ["--controller", &controller, "--gains", "sonic", "--prefix", "5", "--end-on", "time-out"];
    let (log, chunks) = play(&python, "gr00t-sonic", &double, &args);
    let says = "row 3: number 5 of the token is 1.3";
    assert!(log.contains(says) && chunks.len() == 6 && chunks[5].problem.contains(says), "{log}");
    let folder = Scratch::new("unfit");
    let double = Double::start(&python, "gr00t-sonic", &["--embodiment", "unitree_g1_sonic"]);
    let service = Service::start("bridge", &[]);
    for (args, says) in [
        (vec!["--controller", &controller], "open the session with --gains sonic"),
        (vec!["--controller", "gear:nowhere"], "outputs motion tokens; use sonic:DIR"),
        (vec!["--controller", "sonic:nowhere"], "weights are not shipped"),
        (vec![], "--controller sonic:DIR"),
    ] {
        let all = [&["--policy", "vla", "--dialect", "gr00t-sonic", "--model", &double.1, "--task", "S07"], &args[..]];
        let mut client = service.client(&all.concat());
        assert!(!client.finish(PATIENCE).0.success());
        assert!(client.log().contains(says), "{args:?}: {}", client.log());
    }
    let args = ["probe", "--dialect", "gr00t-sonic", "--model", &double.1];
    let mut probe = Running::start("policy-client", &args, &folder);
    assert!(probe.finish(PATIENCE).1.contains("decoder   missing: 'motion_token'"));
}

/// In real time a chunk begins with the row of the step at which it arrives, the next question goes out before the prefix is
/// played by what the last answer took, and a new chunk takes over step by step. All of it follows from the bag: nothing here
/// looks at a clock. On a busy machine an action may come too late for its step and is not in the bag; what is there counts.
#[test]
#[ignore = "needs Python's libraries: tests/run"]
fn real_time_skips_what_is_stale_and_blends() {
    const BLEND: u64 = 6;
    const PREFIX: u64 = 12;
    let python = python();
    // Small pictures: the machine may be slow.
    let folder = Scratch::new("map");
    let map = folder.path().join("small.toml");
    let shipped = include_str!("../../../crates/bridge/mappings/unitree_g1.toml");
    let small = shipped.replace("horizon = 30", "picture = [64, 48]\nhorizon = 30").replace("[640, 480]", "[64, 48]");
    std::fs::write(&map, small).unwrap();
    let double = ["--delay", "0.2", "--ramp", "0.005,0.1", "--size", "64x48", "--fault", "die", "--after", "16"];
    let (blend, prefix, map) = (BLEND.to_string(), PREFIX.to_string(), map.display().to_string());
    let args = ["--real-time", "--map", &map, "--prefix", &prefix, "--blend", &blend, "--end-on", "time-out"];
    let recorded = record(&python, "gr00t", &double, &args);
    let elbow = recorded.bag.header().joint_names.iter().position(|name| name == "left_elbow_joint").unwrap();
    let angle =
        |chunk: &PlayedChunk, step: u64| f64::from(chunk.numbers((step - chunk.observed) as usize, "left_arm")[3]);
    let mut known: BTreeMap<u64, PlayedChunk> = BTreeMap::new();
    let (mut plain, mut blended) = (0, 0);
    for action in &recorded.actions {
        // Before the first chunk the arm holds.
        let Some(chunk) = &action.chunk else { continue };
        if !chunk.values.is_empty() {
            assert!(
                known.insert(chunk.index, PlayedChunk::of(action.step, chunk)).is_none(),
                "a chunk is in the bag once"
            );
        }
        let Some(newest) = known.get(&chunk.index) else { continue };
        let row = action.step - newest.observed;
        assert_eq!((f64::from(chunk.row), chunk.age_s), (row.min(29) as f64, row as f64 * 0.02), "a row a step");
        let since = action.step - newest.arrived;
        let older = chunk.index.checked_sub(1).map(|older| known.get(&older));
        let expected = match older {
            // The first chunk takes over at once.
            None => angle(newest, action.step),
            _ if since >= BLEND => {
                plain += 1;
                angle(newest, action.step)
            }
            Some(None) => continue,
            Some(Some(older)) => {
                let (from, to) = (angle(older, action.step), angle(newest, action.step));
                // The two can be told apart, so that the blend shows.
                blended += usize::from((from - to).abs() > 0.02);
                from + (since + 1) as f64 / (BLEND + 1) as f64 * (to - from)
            }
        };
        let target = action.joint_target[elbow];
        assert!((target - expected).abs() < 1e-6, "step {}: {target} instead of {expected}", action.step);
    }
    assert!(known.len() >= 3 && plain > 0 && blended > 0, "{}, {plain}, {blended}; {}", known.len(), recorded.log);
    for (index, chunk) in &known {
        assert!(chunk.latency_s >= 0.2, "the double takes 0.2 s");
        assert!(chunk.arrived > chunk.observed, "rows that were stale are not played");
        let Some(next) = known.get(&(index + 1)) else { continue };
        let early = (chunk.latency_s / 0.02).ceil() as u64;
        assert!(next.observed + early >= chunk.observed + PREFIX, "asked no earlier than the latency demands");
        assert!(next.observed >= chunk.arrived, "one question is out at a time");
    }
    assert!(recorded.log.contains("policy vla cannot go on"), "{}", recorded.log);
}
