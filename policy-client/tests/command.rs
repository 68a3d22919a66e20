//! The command as a user meets it: its output, its exit codes.

#[path = "../../crates/client/tests/fake/mod.rs"]
mod fake;

use std::path::PathBuf;
use std::process::{Command, Output, Stdio};
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use fiatlux_bag::BagWriter;
use fiatlux_proto::v3::{Action, ActionRecord, EpisodeEnd, EpisodeHeader, EpisodeResult};
use fiatlux_proto::{Message, PROTOCOL};
use serde_json::{Value, json};

use fake::{DIGEST, FakeServer, HORIZON, tcp};

fn policy_client(args: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_policy-client"));
    command.args(args).env_remove("RUST_LOG");
    command
}

/// Exit code, stdout, stderr.
fn run(args: &[&str]) -> (i32, String, String) {
    let Output { status, stdout, stderr } = policy_client(args).output().expect("runs");
    let text = |bytes| String::from_utf8(bytes).expect("text");
    (status.code().expect("exits"), text(stdout), text(stderr))
}

#[test]
fn wrong_usage_exits_with_2_and_says_what_is_right() {
    let cases: [(&[&str], &str); 16] = [
        (
            &["run", "--policy", "waddle", "--task", "S01"],
            "use one of zero, random, hold, stand, wbc[:COMMAND], walk[:FILE], hands, ladder[:FILE], climb[:FILE], expert, see[:FILE], carry[:FILE], vla, gear:DIR, sonic:DIR, replay:BAG",
        ),
        (&["run", "--policy", "zero"], "name a task"),
        (&["run", "--policy", "zero", "--task", "S01", "--set", "fragility"], "write NAME=VALUE"),
        (&["run", "--policy", "zero", "--task", "S01", "--episodes", "0"], "--episodes"),
        (
            &["inspect", "--task", "S05", "--policy", "waddle"],
            "use one of zero, random, hold, stand, wbc[:COMMAND], walk[:FILE], hands, ladder[:FILE], climb[:FILE], expert, see[:FILE], carry[:FILE], vla, gear:DIR, sonic:DIR, replay:BAG",
        ),
        (&["inspect", "--task", "S05", "--values"], "--json"),
        (&["inspect", "--task", "S05", "--seconds", "0"], "write seconds, such as 10"),
        (&["run", "--policy", "zero", "--task", "S01", "--seed", "-1"], "seed -1 is negative; seeds are whole numbers"),
        (
            &["run", "--policy", "zero", "--task", "S01", "-e", "lab:7447"],
            "write tcp/HOST:PORT, such as tcp/127.0.0.1:7447",
        ),
        (
            &["evaluate", "--policy", "waddle"],
            "use one of zero, random, hold, stand, wbc[:COMMAND], walk[:FILE], hands, ladder[:FILE], climb[:FILE], expert, see[:FILE], carry[:FILE], vla, gear:DIR, sonic:DIR, replay:BAG",
        ),
        (&["evaluate", "--policy", "zero", "--seeds", "0", "--hosted", "4"], "cannot be used with"),
        (&["evaluate", "--policy", "zero", "--tasks", "S13"], "there is no task 'S13'"),
        (&["evaluate", "--policy", "zero", "--with", "S03=stand"], "use expert"),
        (&["evaluate", "--policy", "expert", "--with", "replace=stand"], "such as S03=stand"),
        (
            &["evaluate", "--policy", "expert", "--with", "S03=stand", "--tasks", "S05"],
            "choose tasks that it plays: --tasks replace",
        ),
        (&[], "Usage: policy-client"),
    ];
    for (args, part) in cases {
        let (code, stdout, stderr) = run(args);
        assert_eq!((code, stdout.as_str()), (2, ""), "{args:?}: {stderr}");
        assert!(stderr.contains(part), "{args:?}: {stderr}");
    }
}

#[test]
fn without_a_server_it_fails_and_names_where_it_looked() {
    let (code, stdout, stderr) = run(&["run", "--policy", "zero", "--task", "S01", "-e", "tcp/127.0.0.1:9"]);
    assert_eq!((code, stdout.as_str()), (1, ""), "{stderr}");
    assert!(stderr.contains("nothing answers at tcp/127.0.0.1:9") && stderr.contains("-e tcp/HOST:PORT"), "{stderr}");
}

#[test]
fn a_run_prints_its_result_and_the_servers_are_listed() {
    let ([link, _], endpoint) = tcp();
    let _server = FakeServer::new(&link, "lab", 0);
    let (code, stdout, stderr) = run(&["run", "--policy", "zero", "--task", "S01", "-e", &endpoint]);
    assert_eq!(code, 0, "{stderr}");
    let said = "S01 seed 0 episode 0: no strict success; ended by time-out after 200 steps\n    4.00 s simulated in ";
    assert!(stdout.starts_with(said) && stdout.lines().all(|line| line.len() <= 80), "{stdout}");
    for mode in ["peer", "client"] {
        let args = ["run", "-p", "zero", "-t", "S01", "-n", "2", "--json", "-e", &endpoint, "--mode", mode];
        let (code, stdout, stderr) = run(&args);
        assert_eq!(code, 0, "{stderr}");
        let result: Value = serde_json::from_str(&stdout).expect("JSON");
        let steps = result["episodes"].as_array().expect("a list").iter().map(|episode| episode["steps"].as_u64());
        assert_eq!(steps.collect::<Vec<_>>(), [Some(HORIZON); 2]);
    }
    let (code, stdout, _) = run(&["list", "-e", &endpoint]);
    assert!(code == 0 && stdout.starts_with("lab "), "{stdout}");
    let (code, stdout, _) = run(&["list", "--json", "-e", &endpoint]);
    let servers: Value = serde_json::from_str(&stdout).expect("JSON");
    assert_eq!((code, servers[0]["server"].as_str()), (0, Some("lab")));
}

/// Text and JSON; a sensor and a task that the server does not know.
#[test]
fn an_inspection_says_what_a_policy_receives() {
    let ([link, _], endpoint) = tcp();
    let server = FakeServer::new(&link, "lab", 0);
    let inspect = |task: &str, more: &[&str]| {
        let args = ["inspect", "--task", task, "--policy", "zero", "-e", &endpoint];
        run(&[&args[..], more].concat())
    };
    let (code, stdout, stderr) = inspect("S01", &["--seconds", "2"]);
    assert_eq!(code, 0, "{stderr}");
    assert!(server.closed.load(Ordering::Relaxed));
    for part in ["step 100 of 200 (2.00 s)", "gate: standing held in 100 %", "a look takes", "16x16x3"] {
        assert!(stdout.contains(part), "{part}: {stdout}");
    }
    let (code, stdout, stderr) = inspect("S01", &["--json", "--values"]);
    let result: Value = serde_json::from_str(&stdout).expect("JSON");
    assert_eq!((code, &result["end"]["cause"], &result["gate"]["steps"]), (0, &"time-out".into(), &HORIZON.into()));
    let camera = &result["sensors"][5];
    assert_eq!(
        (&camera["count"], &camera["terms"][0]["values"][767]),
        (&json!(HORIZON / 5), &json!(100.0)),
        "{stderr}"
    );

    for (task, more, words) in [
        ("S99", &[][..], "server lab refuses 'task': there is no S99; use S01"),
        ("S01", &["--sensors", "smell@10"], "server lab refuses 'sensors': sensor 'smell' does not exist"),
    ] {
        let (code, stdout, stderr) = inspect(task, more);
        assert!(code != 0 && stdout.is_empty() && stderr.contains(words), "{stdout}{stderr}");
    }
}

#[test]
fn a_replay_compares_digests() {
    let ([link, _], endpoint) = tcp();
    let _server = FakeServer::new(&link, "lab", 0);
    for (digest, code, words) in [(DIGEST, 0, "digest equal"), ("1234", 1, "digest differs: the bag has 1234")] {
        let bag = bag(digest);
        let (found, stdout, stderr) = run(&["run", "--policy", &format!("replay:{}", bag.display()), "-e", &endpoint]);
        std::fs::remove_file(bag).expect("removes");
        assert_eq!(found, code, "{stdout}{stderr}");
        assert!(stdout.contains(words) && stdout.contains("seed 5 episode 2"), "{stdout}");
    }
}

/// A server that keeps no runs says so in time, and a run file is left as it was.
#[test]
fn a_server_without_runs_is_named() {
    let ([link, _], endpoint) = tcp();
    let _server = FakeServer::new(&link, "lab", 0);
    let file = std::env::temp_dir().join(format!("fiatlux-command-run-{}.toml", std::process::id()));
    let path = file.display().to_string();
    let evaluate = |policy: &str| {
        run(&["evaluate", "--policy", policy, "--tasks", "S01", "--seeds", "0", "--run-file", &path, "-e", &endpoint])
    };
    let (code, stdout, stderr) = evaluate("zero");
    assert_eq!((code, stdout.as_str()), (1, ""), "{stderr}");
    assert!(stderr.contains("fiatlux/v3/lab/run was not answered"), "{stderr}");
    let text = std::fs::read(&file).expect("it is there");
    let (code, _, stderr) = evaluate("random");
    assert!(code == 2 && stderr.contains("which differs in the policy") && stderr.contains("--run-file"), "{stderr}");
    assert_eq!(std::fs::read(&file).expect("it is there"), text);
    std::fs::remove_file(file).expect("removes");
}

#[cfg(unix)]
#[test]
fn ctrl_c_closes_the_session() {
    let ([link, _], endpoint) = tcp();
    let server = FakeServer::new(&link, "lab", 0);
    let args = ["run", "--policy", "zero", "--task", "S01", "--episodes", "1000000", "-e", &endpoint];
    let child = policy_client(&args).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().expect("starts");
    let until = Instant::now() + Duration::from_secs(20);
    while server.steps.load(Ordering::Relaxed) == 0 {
        assert!(Instant::now() < until, "it does not start");
        std::thread::sleep(Duration::from_millis(10));
    }
    let sent = Command::new("kill").args(["-INT", &child.id().to_string()]).status().expect("sends");
    assert!(sent.success());
    let output = child.wait_with_output().expect("ends");
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{stderr}");
    assert!(server.closed.load(Ordering::Relaxed) && stderr.contains("stopped"), "{stderr}");
}

/// A bag of an episode that the fake server answers in the same way.
fn bag(digest: &str) -> PathBuf {
    let path = std::env::temp_dir().join(format!("fiatlux-command-{digest}-{}.mcap", std::process::id()));
    let header = EpisodeHeader {
        protocol: Some(PROTOCOL),
        policy: "old".into(),
        task: "S01".into(),
        seed: 5,
        episode: 2,
        joint_names: vec![String::new(); 2],
        ..EpisodeHeader::default()
    };
    let mut bag = BagWriter::create(&path, &header).expect("creates");
    bag.message("/state", 0, &[]).expect("writes");
    for step in 0..HORIZON {
        let action = Action { episode: 2, step, action: vec![0.5; 2], ..Action::default() };
        let record = ActionRecord { action: Some(action), ..ActionRecord::default() };
        bag.message("/action", step + 1, &record.encode_to_vec()).expect("writes");
        bag.message("/state", step + 1, &[]).expect("writes");
    }
    let end = EpisodeEnd { digest: digest.into(), ..EpisodeEnd::default() };
    bag.finish(&EpisodeResult { end: Some(end), ..EpisodeResult::default() }).expect("finishes");
    path
}

/// Guards against results that are lost without a word, as on a full disk.
#[test]
fn results_that_cannot_be_written_are_a_failure() {
    for args in [&["list", "--policies"][..], &["list", "--policies", "--json"]] {
        let full = std::fs::OpenOptions::new().write(true).open("/dev/full").expect("a full disk");
        let output = policy_client(args).stdout(full).output().expect("runs");
        let err = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.code() == Some(1) && err.contains("cannot be written to stdout: No space"), "{err}");
    }
}

/// Guards what scripts ask for: the tasks of each policy, and none where its file decides.
#[test]
fn policies_are_listed_with_their_tasks() {
    let output = policy_client(&["list", "--policies", "--json"]).output().expect("runs");
    let listed: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    let tasks = |name: &str| {
        let found = listed.as_array().expect("a list").iter().find(|policy| policy["policy"] == name);
        found.unwrap_or_else(|| panic!("{name}: {listed}"))["tasks"].clone()
    };
    assert_eq!(tasks("carry[:FILE]"), json!(["S01"]));
    assert_eq!(tasks("walk[:FILE]"), json!(["S05", "S07", "S09"]));
    assert_eq!(tasks("see[:FILE]").as_array().map(Vec::len), Some(11));
    assert!(tasks("replay:BAG").is_null() && tasks("vla").is_null());
}
