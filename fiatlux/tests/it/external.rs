//! `fiatlux evaluate --external` as a user meets it: one line for the client, results at the end, exit codes.

use std::fs;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use fiatlux_client::{Client, Policy, PolicyError, RunFile, RunOptions, RunOutcome, RunProgress};
use fiatlux_grading::{GradeOptions, false_claim, grade};
use fiatlux_link::{CarrierArgs, Role};
use fiatlux_proto::v3::{Observation, OpenRequest, RunSpec, SessionInfo};
use serde_json::Value;

fn folder(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("external").join(name);
    let _ = fs::remove_dir_all(&folder);
    fs::create_dir_all(&folder).unwrap();
    folder
}

fn fiatlux(args: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_fiatlux"));
    command.arg("evaluate").args(args).env_remove("RUST_LOG");
    command
}

/// It runs, and the endpoint of its line; stdout for the rest.
fn serve(out: &Path, more: &[&str]) -> (Child, String, BufReader<std::process::ChildStdout>) {
    let args = [&["--external", "--name", "test", "--out", out.to_str().unwrap()], more].concat();
    let mut child = fiatlux(&args).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let mut stdout = BufReader::new(child.stdout.take().unwrap());
    let mut line = String::new();
    stdout.read_line(&mut line).unwrap();
    let words: Vec<&str> = line.split_whitespace().collect();
    let ["policy-client", "evaluate", "--policy", "NAME", "-e", endpoint, "--server", "test"] = words[..] else {
        panic!("{line}")
    };
    let endpoint = endpoint.to_string();
    (child, endpoint, stdout)
}

/// `zero`, at that many ms a step.
struct Slow(Box<dyn Policy>, Duration);

impl Policy for Slow {
    fn name(&self) -> String {
        self.0.name()
    }

    fn reset(&mut self, info: &SessionInfo, first: &Observation) -> Result<(), PolicyError> {
        self.0.reset(info, first)
    }

    fn act(&mut self, observation: &Observation) -> Result<fiatlux_client::Command, PolicyError> {
        std::thread::sleep(self.1);
        self.0.act(observation)
    }
}

fn play(
    endpoint: &str,
    out: &Path,
    wait_ms: u64,
    progress: &mut dyn FnMut(&RunProgress),
    stop: &AtomicBool,
) -> RunOutcome {
    let thresholds = [("fall_tilt_rad".to_string(), 0.1)].into();
    let spec = RunSpec {
        policy: "zero".into(),
        tasks: vec!["S05".into()],
        seeds: vec![0, 1, 2],
        session: Some(OpenRequest { thresholds, ..OpenRequest::default() }),
        ..RunSpec::default()
    };
    let link = CarrierArgs { connect: vec![endpoint.into()], ..CarrierArgs::default() }
        .open(Role::Client)
        .unwrap()
        .session()
        .clone();
    let options = RunOptions {
        server: Some("test".into()),
        parallel: Some(1),
        ..RunOptions::new(RunFile::open(&out.join("RUN.toml"), &spec).unwrap())
    };
    let wait = Duration::from_millis(wait_ms);
    let make = || Ok(Box::new(Slow(fiatlux_policies::Policies::default().make("zero")?, wait)) as Box<dyn Policy>);
    Client::evaluate(&fiatlux_link::carrier(&link), &options, make, progress, stop).unwrap()
}

fn results(out: &Path) -> Vec<Value> {
    let text = fs::read(out.join("results.json")).unwrap();
    let results: Value = serde_json::from_slice(&text).unwrap();
    results["episodes"].as_array().unwrap().clone()
}

#[test]
fn a_run_from_elsewhere_is_graded() {
    let out = folder("graded");
    let (mut child, endpoint, mut stdout) = serve(&out, &[]);
    // Nobody else works in the folder meanwhile.
    let other = fiatlux(&["--policy", "zero", "--out", out.to_str().unwrap()]).output().unwrap();
    let said = String::from_utf8(other.stderr).unwrap();
    assert!(other.status.code() == Some(1) && said.contains("another evaluation is at work in it"), "{said}");

    let outcome = play(&endpoint, &out, 0, &mut |_| (), &AtomicBool::new(false));
    assert!(outcome.is_whole() && outcome.finished, "{outcome:?}");
    let mut table = String::new();
    stdout.read_to_string(&mut table).unwrap();
    assert_eq!(child.wait().unwrap().code(), Some(0));
    assert!(table.contains("S05"), "{table}");
    let graded = results(&out);
    let digests: Vec<&str> = graded.iter().map(|episode| episode["state_digest"].as_str().unwrap()).collect();
    let played: Vec<&str> = outcome.episodes.iter().map(|episode| episode.digest.as_str()).collect();
    assert_eq!(digests, played);
    assert!(out.join("report.html").exists());
    // The same as `scorer grade` makes of the folder.
    let regraded = grade(std::slice::from_ref(&out), &GradeOptions::default(), &|_| {}).unwrap();
    assert!(regraded.run.is_some());
    assert_eq!(false_claim(&out, &regraded), None);

    // The run in the folder is over: it is graded once more, and nobody is waited for.
    let again = fiatlux(&["--external", "--name", "test", "--out", out.to_str().unwrap(), "--json"]).output().unwrap();
    assert_eq!(again.status.code(), Some(0));
    assert_eq!(serde_json::from_slice::<Value>(&again.stdout).unwrap()["episodes"], Value::from(graded));
}

/// Ctrl-C on both sides, and the same commands once more.
#[cfg(unix)]
#[test]
fn an_interrupted_run_is_graded_and_goes_on() {
    let out = folder("interrupted");
    let (child, endpoint, _stdout) = serve(&out, &[]);
    let stop = AtomicBool::new(false);
    let outcome = play(&endpoint, &out, 40, &mut |look| stop.store(look.done > 0, Ordering::Relaxed), &stop);
    let status = Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
    assert!(status.success());
    let output = child.wait_with_output().unwrap();
    let said = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(3), "{said}");
    assert!(said.contains(&format!("--listen {endpoint} --out")), "{said}");
    // Episodes that were not played count as failures until they are.
    let rows = results(&out);
    let played = rows.iter().filter(|row| row["failure"].is_null()).count();
    assert!((1..3).contains(&played) && rows.len() == 3, "{rows:#?}");
    assert!(outcome.stopped && !outcome.finished, "{outcome:?}");

    let (mut child, again, _stdout) = serve(&out, &["--listen", &endpoint]);
    assert_eq!(again, endpoint);
    assert!(play(&endpoint, &out, 0, &mut |_| (), &AtomicBool::new(false)).is_whole());
    assert_eq!(child.wait().unwrap().code(), Some(0));
    let rows = results(&out);
    assert!(rows.len() == 3 && rows.iter().all(|row| row["failure"].is_null()), "{rows:#?}");
}

#[test]
fn wrong_usage_exits_with_2_and_says_what_is_right() {
    let cases: [(&[&str], &str); 7] = [
        (&[], "--policy <POLICY>"),
        (&["--external", "--policy", "zero"], "cannot be used with"),
        (
            &["--external", "--tasks", "S01"],
            "the client names tasks and seeds: give --tasks and --seeds to policy-client",
        ),
        (&["--external", "--gains", "sonic"], "give these flags to policy-client evaluate"),
        (&["--external", "--name", "a/b"], "use 1 to 64 letters, digits, - or _"),
        (&["--external", "--listen", "127.0.0.1:7447"], "write tcp/HOST:PORT, such as tcp/127.0.0.1:7447"),
        (&["--policy", "zero", "--seeds", "-1"], "seed -1 is negative; seeds are whole numbers from 0 on"),
    ];
    for (args, part) in cases {
        let output = fiatlux(args).output().unwrap();
        let said = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.code() == Some(2) && said.contains(part), "{args:?}: {said}");
    }
}
