//! Duties of every program: its name, a word on what it waits for, an end on the first signal, IPv6, and
//! errors of one sentence.

use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::process::{Command, Stdio};
use std::time::Duration;

use fiatlux_tests::programs::{PATIENCE, Running, Scratch, endpoint, free_port, program, wait_until};

const PROGRAMS: [&str; 5] = ["fiatlux", "sim-server", "recorder", "policy-client", "scorer"];
/// Longest time from a signal to the end of a program that has nothing to save.
const END: Duration = Duration::from_secs(5);

fn text(scratch: &Scratch, file: &str) -> String {
    scratch.path().join(file).display().to_string()
}

/// Makes the keys of an installation in the folder `keys`.
fn make_keys(scratch: &Scratch, flags: &[&str]) {
    let out = text(scratch, "keys");
    let mut keys = Running::start("fiatlux", &[&["keys", "--out", &out], flags].concat(), scratch);
    assert!(keys.finish(PATIENCE).0.success(), "{}", keys.log());
}

#[test]
fn every_program_says_its_own_name() {
    let scratch = Scratch::new("names");
    for name in PROGRAMS {
        let said = Running::start(name, &["--version"], &scratch).finish(PATIENCE).1;
        assert!(said.starts_with(&format!("{name} ")), "{said}");
    }
}

#[test]
fn no_workers_are_refused_everywhere() {
    let scratch = Scratch::new("workers");
    let cases: [(&str, &[&str]); 5] = [
        ("sim-server", &["--workers", "0"]),
        ("fiatlux", &["evaluate", "--policy", "zero", "--workers", "0"]),
        ("fiatlux", &["render", "a.mcap", "-o", "a.png", "--workers", "0"]),
        ("scorer", &["grade", "bags", "--workers", "0"]),
        ("scorer", &["serve", "--folder", "board", "--workers", "0"]),
    ];
    for (name, args) in cases {
        let mut running = Running::start(name, args, &scratch);
        assert_eq!(running.finish(PATIENCE).0.code(), Some(2), "{name} {args:?}");
        assert!(running.log().contains("give a whole number from 1 to "), "{}", running.log());
    }
}

/// Guards results that are lost without a word where the disk is full, and a reader that has left, as `head` does.
#[test]
fn what_cannot_be_printed_is_said() {
    let scratch = Scratch::new("printed");
    let router = endpoint(free_port());
    let mut server = Running::start("sim-server", &["-l", &router], &scratch);
    server.wait_for("listening on");
    let [text_keys, json_keys] = ["text", "json"].map(|name| text(&scratch, name));
    let commands: [(&str, &[&str]); 9] = [
        ("fiatlux", &["keys", "--out", &text_keys]),
        ("fiatlux", &["keys", "--json", "--out", &json_keys]),
        ("fiatlux", &["policies"]),
        ("fiatlux", &["sensors", "--json"]),
        ("fiatlux", &["router", "-l", &endpoint(free_port())]),
        ("sim-server", &["-l", &endpoint(free_port())]),
        ("policy-client", &["list", "-e", &router]),
        ("policy-client", &["list", "--policies"]),
        ("scorer", &["admin", "--folder", &text(&scratch, "board"), "init"]),
    ];
    for (name, args) in commands {
        let full = std::fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
        let done = Command::new(program(name)).args(args).stdin(Stdio::null()).stdout(full).output().unwrap();
        let err = String::from_utf8_lossy(&done.stderr);
        let said = "error: the results cannot be written to stdout: No space left on device";
        assert!(done.status.code() == Some(1) && err.contains(said), "{name} {args:?}: {}: {err}", done.status);
        if args.contains(&"-l") {
            continue;
        }
        // Keys are made into a new folder alone.
        drop(std::fs::remove_dir_all(scratch.path().join(args[args.len() - 1])));
        let (reader, writer) = std::io::pipe().unwrap();
        drop(reader);
        let done = Command::new(program(name)).args(args).stdin(Stdio::null()).stdout(writer).output().unwrap();
        let err = String::from_utf8_lossy(&done.stderr);
        assert!(done.status.success() && !err.contains("error"), "{name} {args:?}: {}: {err}", done.status);
    }
}

/// A mistyped name is said with the nearest one by every program, and before a folder is made.
#[test]
fn a_mistyped_name_makes_no_folder() {
    let scratch = Scratch::new("mistyped");
    let [out, bags, first, second] = ["out", "bags", "first.toml", "second.toml"].map(|file| text(&scratch, file));
    let served = endpoint(free_port());
    let mut server = Running::start("sim-server", &["-l", &served, "--record", &bags], &scratch);
    server.wait_for("listening on");
    let evaluate = ["evaluate", "--out", &out, "--seeds", "fresh:2", "--policy", "zero"];
    let demonstrate = ["demonstrate", "--out", &out, "--episodes", "1", "--task", "S07"];
    let run = ["run", "-e", &served, "--policy", "zero", "--task", "S07"];
    let of_run = |file| ["evaluate", "-e", &served, "--policy", "zero", "--tasks", "S07", "--run-file", file];
    let [with_sensor, with_robot] = [&first, &second].map(|file| of_run(file));
    let inspect = ["inspect", "-e", &served, "--task", "S07"];
    let teleop = ["teleop", "-e", &served, "--task", "S07"];
    let (sensor, robot) = (["--sensors", "camra"], ["--robot", "g1_inspier"]);
    let (camera, inspire) = ("did you mean 'camera'?", "did you mean 'g1_inspire'?");
    // A program, its command line, the name in it, and what it says.
    type Case<'a> = (&'a str, &'a [&'a str], &'a [&'a str], i32, &'a str);
    let cases: [Case<'_>; 15] = [
        ("fiatlux", &evaluate, &sensor, 2, camera),
        ("fiatlux", &evaluate, &robot, 2, inspire),
        ("fiatlux", &evaluate, &["--gains", "sonics"], 2, "did you mean 'sonic'?"),
        ("fiatlux", &evaluate[..5], &["--policy", "wlak"], 2, "did you mean 'walk'?"),
        ("fiatlux", &evaluate, &["--tasks", "cilmb"], 2, "did you mean 'climb'?"),
        ("fiatlux", &demonstrate, &sensor, 2, camera),
        ("fiatlux", &demonstrate, &robot, 2, inspire),
        ("fiatlux", &["teleop", "--out", &out, "--task", "S07"], &robot, 2, inspire),
        ("policy-client", &run, &sensor, 1, camera),
        ("policy-client", &run, &robot, 1, inspire),
        ("policy-client", &with_sensor, &sensor, 1, camera),
        ("policy-client", &with_robot, &robot, 1, inspire),
        ("policy-client", &inspect, &sensor, 1, camera),
        ("policy-client", &inspect, &robot, 1, inspire),
        ("policy-client", &teleop, &robot, 2, inspire),
    ];
    for (name, args, wrong, code, near) in cases {
        let mut running = Running::start(name, &[args, wrong].concat(), &scratch);
        let ended = running.finish(PATIENCE).0.code();
        assert!(ended == Some(code) && running.log().contains(near), "{name} {args:?}: {ended:?}: {}", running.log());
        assert!(!scratch.path().join("out").exists(), "{name} {args:?} made it");
    }
}

/// A server without its router and a recorder without a server say what they wait for, and end on SIGTERM.
#[test]
fn who_waits_says_so_and_ends_on_the_first_signal() {
    let scratch = Scratch::new("waits");
    make_keys(&scratch, &[]);
    let [dead, live] = [free_port(), free_port()].map(|port| format!("tcp/127.0.0.1:{port}"));
    let mut router = Running::start("fiatlux", &["router", "-l", &live], &scratch);
    router.wait_for("as a router");
    let (key, bags) = (text(&scratch, "keys/recorder_key"), text(&scratch, "bags"));
    let recorder = ["-e", &live, "--out", &bags, "--recorder-key", &key];
    let nothing = format!("waiting for {dead}, which does not answer");
    let cases: [(&str, &[&str], &str); 2] = [
        ("sim-server", &["-e", &dead], &nothing),
        ("recorder", &recorder, "waiting for a server: none is on this network"),
    ];
    let mut all = cases.map(|(name, args, said)| (Running::start(name, args, &scratch), said));
    for (running, said) in &mut all {
        wait_until(said, PATIENCE, || running.log().contains(*said));
        running.signal("TERM");
        running.finish(END);
    }
    router.signal("TERM");
    assert!(router.finish(END).0.success());
}

/// Router, server, recorder and client find each other at an IPv6 address.
#[test]
#[ignore = "needs IPv6: tests/run"]
fn programs_find_each_other_by_ipv6() {
    let scratch = Scratch::new("ipv6");
    make_keys(&scratch, &["--host", "::1", "--auth", "password", "--port", &free_port().to_string()]);
    let key = |name: &str| text(&scratch, &format!("keys/{name}"));
    let mut router = Running::start("fiatlux", &["router", "-c", &key("router.json5")], &scratch);
    router.wait_for("as a router");
    let [config, identity, tokens, recorder_key] =
        ["server.json5", "server_identity", "server_tokens", "recorder_key"].map(key);
    let server = ["-c", &config, "--identity", &identity, "--tokens", &tokens, "--recorder-key", &recorder_key];
    let mut server = Running::start("sim-server", &server, &scratch);
    server.wait_for("connected to tcp/[::1]:");
    let [config, bags] = [key("recorder.json5"), text(&scratch, "bags")];
    let recorder = ["-c", &config, "--recorder-key", &recorder_key, "--out", &bags, "--flat"];
    let mut recorder = Running::start("recorder", &recorder, &scratch);
    let [config, known, token] = ["policy.json5", "known_servers", "policy_token"].map(key);
    let access = ["-c", &config, "--known-servers", &known, "--token", &token];
    let play = ["run", "--policy", "zero", "--task", "S07", "--seed", "1", "--recorded"];
    let mut client = Running::start("policy-client", &[&play[..], &access].concat(), &scratch);
    assert!(client.finish(PATIENCE).0.success(), "{}", client.log());
    recorder.wait_for("S07-s1-e0.mcap");
    for running in [&mut recorder, &mut server, &mut router] {
        running.signal("TERM");
        assert!(running.finish(END).0.success());
    }
}

/// Whom the router refuses is told so, in one sentence.
#[test]
fn a_refusal_is_one_sentence() {
    let scratch = Scratch::new("refusal");
    make_keys(&scratch, &["--auth", "password", "--port", &free_port().to_string()]);
    let mut router = Running::start("fiatlux", &["router", "-c", &text(&scratch, "keys/router.json5")], &scratch);
    router.wait_for("as a router");
    let config = std::fs::read_to_string(scratch.path().join("keys/policy.json5")).unwrap();
    let wrong = text(&scratch, "wrong.json5");
    std::fs::write(&wrong, config.replace("\"password\": \"", "\"password\": \"0")).unwrap();
    let mut client = Running::start("policy-client", &["list", "-c", &wrong], &scratch);
    assert_eq!(client.finish(PATIENCE).0.code(), Some(1));
    let log = client.log();
    assert!(log.contains("answers, but opens no session"), "{log}");
    assert_eq!(log.lines().count(), 1, "{log}");
}

/// A server says on an address of its own what it has done since its start, in the form of Prometheus.
#[test]
fn a_server_has_metrics() {
    let scratch = Scratch::new("metrics");
    let [endpoint, metrics] =
        [("tcp/", free_port()), ("", free_port())].map(|(kind, port)| format!("{kind}127.0.0.1:{port}"));
    let bags = text(&scratch, "bags");
    let serve = ["-l", &endpoint, "--record", &bags, "--capacity", "3", "--metrics", &metrics];
    let mut server = Running::start("sim-server", &serve, &scratch);
    server.wait_for("as local");
    let page = |path: &str| {
        let mut stream = TcpStream::connect(&metrics).unwrap();
        write!(stream, "GET {path} HTTP/1.1\r\nHost: lab\r\nConnection: close\r\n\r\n").unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        answer
    };
    let figure = |name: &str| -> u64 {
        let page = page("/metrics");
        let line = page.lines().find_map(|line| line.strip_prefix(&format!("fiatlux_server_{name} "))).map(str::parse);
        line.unwrap_or_else(|| panic!("no {name} in {page}")).unwrap()
    };
    assert_eq!(["sessions_capacity", "sessions_open", "sessions_total", "records_total"].map(figure), [3, 0, 0, 0]);
    assert!(page("/").starts_with("HTTP/1.1 404 "));
    let play = ["run", "-e", &endpoint, "--policy", "zero", "--task", "S07", "--seed", "1", "--recorded"];
    let mut client = Running::start("policy-client", &play, &scratch);
    assert!(client.finish(PATIENCE).0.success(), "{}", client.log());
    wait_until("the bag counts", PATIENCE, || figure("bags_total{end=\"whole\"}") == 1);
    wait_until("the session is over", PATIENCE, || figure("sessions_open") == 0);
    assert_eq!(["sessions_total", "bags_total{end=\"cut\"}", "refused_messages_total"].map(figure), [1, 0, 0]);
    // `zero` falls within a few seconds.
    assert!((20..1000).contains(&figure("records_total")), "{}", figure("records_total"));
    let mut second = Running::start("sim-server", &["--name", "other", "--metrics", &metrics], &scratch);
    assert_eq!(second.finish(PATIENCE).0.code(), Some(1));
    assert!(second.log().contains("the address cannot be used; choose another port"), "{}", second.log());
    server.signal("TERM");
    assert!(server.finish(END).0.success());
}
