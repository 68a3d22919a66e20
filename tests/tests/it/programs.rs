//! Duties of every program: its name, a word on what it waits for, an end on the first signal, IPv6, and
//! errors of one sentence.

use std::io::{Read as _, Write as _};
use std::net::{TcpListener, TcpStream};
use std::time::Duration;

use fiatlux_tests::programs::{PATIENCE, Running, Scratch, free_port, wait_until};

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
fn every_program_speaks_ipv6() {
    if TcpListener::bind("[::1]:0").is_err() {
        eprintln!("this machine has no IPv6");
        return;
    }
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
