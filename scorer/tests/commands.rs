//! The program: what its commands print, and their exit codes.
#![allow(clippy::unwrap_used)]

#[path = "../../crates/grading/tests/common/mod.rs"]
mod common;
#[path = "commands/merge.rs"]
mod merge;

use std::process::{Command, Stdio};

use common::{Folder, Story, begin, header, result, rows};
use fiatlux_grading::RESULTS_VERSION;
use fiatlux_rules::Task;
use serde_json::{Value, json};

/// Exit code, stdout and stderr.
fn scorer(args: &[&str]) -> (i32, String, String) {
    let output = Command::new(env!("CARGO_BIN_EXE_scorer")).args(args).output().unwrap();
    let [out, err] = [output.stdout, output.stderr].map(|bytes| String::from_utf8(bytes).unwrap());
    (output.status.code().unwrap(), out, err)
}

/// Output and exit code say that a bag was changed; other thresholds hide nothing.
#[test]
fn a_changed_bag_shows_in_table_json_and_exit_code() {
    let folder = Folder::new("commands-changed");
    let (header, rows) = (header(Task::S01, 3), rows(Task::S01, 3, Story::Succeeds(30)));
    let result = result(&header, &rows);
    let changed = fiatlux_proto::v3::EpisodeHeader { seed: 1, ..header };
    begin(&folder.0.join("a.mcap"), &changed, &rows).finish(&result).unwrap();
    let path = folder.0.to_str().unwrap();
    let (code, text, _) = scorer(&["grade", path]);
    // Wrapped, wherever the folder's name ends.
    let text = text.split_whitespace().collect::<Vec<_>>().join(" ");
    assert!(code == 3 && text.contains("header was changed"), "{code}: {text}");
    let (code, text, _) = scorer(&["grade", path, "--json", "--set", "fragility_n=30"]);
    let json: Value = serde_json::from_str(&text).unwrap();
    assert_eq!((code, json["excluded"][0]["reason"].as_str()), (3, Some("altered")));
    assert_eq!(json["episodes"].as_array().map(Vec::len), Some(0));
}

/// Guards against a `results.json` that its bags do not support: whoever grades a folder is told.
#[test]
fn a_claim_is_compared_with_the_bags() {
    let folder = Folder::new("commands-claim");
    for seed in [3, 4] {
        let (header, rows) = (header(Task::S01, seed), rows(Task::S01, seed, Story::Succeeds(30)));
        let result = result(&header, &rows);
        begin(&folder.0.join(format!("{seed}.mcap")), &header, &rows).finish(&result).unwrap();
    }
    let (path, claim) = (folder.0.to_str().unwrap(), folder.0.join("results.json"));
    // From another folder the names of bags differ, and nothing else; of a copy the detail has such a name.
    let copy = folder.0.join("copy.mcap");
    std::fs::copy(folder.0.join("3.mcap"), &copy).unwrap();
    let (code, json, _) = scorer(&["grade", path, "--json", "--out", claim.to_str().unwrap()]);
    assert_eq!((code, json.as_str()), (0, ""));
    let (code, _, err) = scorer(&["grade", path]);
    assert_eq!((code, err), (0, format!("{path}/results.json says the same as its bags\n")));
    std::fs::remove_file(copy).unwrap();
    let (code, json, _) = scorer(&["grade", path, "--json", "--out", claim.to_str().unwrap()]);
    assert_eq!((code, json.as_str()), (0, ""));
    let other = std::fs::read_to_string(&claim).unwrap().replacen("\"success\": true", "\"success\": false", 1);
    std::fs::write(&claim, other).unwrap();
    let (code, _, err) = scorer(&["grade", path]);
    assert!(code == 3 && err.contains("episodes[0].success is true by the bags, false in the file"), "{err}");
    // Written anew it says nothing; nor does it for several folders at once.
    let (code, _, err) = scorer(&["grade", path, "--json", "--out", claim.to_str().unwrap()]);
    assert!(code == 0 && err.is_empty(), "{err}");
    let honest = std::fs::read_to_string(&claim).unwrap();
    for (from, to, says) in [
        ("\"run\": null", "\"run\": RUN", "is of a run, but its folder has no journal"),
        ("\"mean\": ", "\"mean\": 0.5e0, \"was\": ", "score.mean is "),
        ("\"observations\": \"standard\"", "\"observations\": \"exact\"", "conditions.observations is standard"),
    ] {
        let run = r#"{"name":"r","folder":"","policy_version":"","policy_link":"","servers":[],"finished":true,"hosted":true,
            "registered":2,"played":2,"failed":{},"repeated":0,"begun_again":0,"failures":[],"notes":[]}"#;
        assert!(honest.contains(from), "{from}");
        std::fs::write(&claim, honest.replacen(from, &to.replace("RUN", run), 1)).unwrap();
        let (code, _, err) = scorer(&["grade", path]);
        assert!(code == 3 && err.contains(says), "{says}: {err}");
    }
    std::fs::write(&claim, honest).unwrap();
    // An episode that is gone, and a seed that lacks it.
    std::fs::remove_file(folder.0.join("4.mcap")).unwrap();
    let (code, _, err) = scorer(&["grade", path]);
    assert!(code == 3 && err.contains("number of episodes is 1 by the bags, 2 in the file"), "{err}");
    std::fs::write(&claim, "{").unwrap();
    assert!(scorer(&["grade", path]).2.contains("cannot be compared"));
}

/// Guards against bad episodes that are left out together with the journal that lists them.
#[test]
fn a_missing_journal_shows_in_the_exit_code() {
    let folder = Folder::new("commands-journal");
    let ticket = fiatlux_proto::v3::RunTicket { run: "first".into(), attempt: 1, ..Default::default() };
    let header = fiatlux_proto::v3::EpisodeHeader { run: Some(ticket), ..header(Task::S01, 3) };
    let rows = rows(Task::S01, 3, Story::Succeeds(30));
    begin(&folder.0.join("a.mcap"), &header, &rows).finish(&result(&header, &rows)).unwrap();
    let (code, json, err) = scorer(&["grade", folder.0.to_str().unwrap(), "--json"]);
    let says =
        "these bags belong to the run first, whose journal is missing: nobody can tell which episodes were left out";
    assert_eq!((code, err), (3, format!("warning: {says}\n")));
    let json: Value = serde_json::from_str(&json).unwrap();
    assert_eq!((&json["without_journal"], json["episodes"].as_array().map(Vec::len)), (&json!(["first"]), Some(1)));
}

/// Guards the words for a `results.json` of fewer episodes than its folder has, and the score of a part of the subtasks.
#[test]
fn a_part_of_the_benchmark_says_so() {
    let folder = Folder::new("commands-part");
    let write = |seed| common::write(&folder.0.join(format!("{seed}.mcap")), Task::S01, seed, Story::Succeeds(30));
    write(3);
    let (path, claim) = (folder.0.to_str().unwrap(), folder.0.join("results.json"));
    let (code, _, _) = scorer(&["grade", path, "--json", "--out", claim.to_str().unwrap()]);
    assert_eq!(code, 0);
    write(4);
    let (code, text, err) = scorer(&["grade", path]);
    assert!(code == 3 && err.contains("number of episodes is 2 by the bags, 1 in the file; it has a part"), "{err}");
    let first = text.lines().next();
    assert!(first.is_some_and(|line| line.ends_with(" over 1 of 12 subtasks: not comparable")), "{text}");
    // The remedy that the message names.
    assert_eq!(scorer(&["grade", path, "--json", "--out", claim.to_str().unwrap()]).0, 0);
    assert_eq!(scorer(&["grade", path]).0, 0);
}

#[test]
fn administration_asks_for_its_folder() {
    let (code, _, err) = scorer(&["admin", "accounts"]);
    assert!(code == 2 && err.contains("--folder"), "{code}: {err}");
}

/// Guards against a mistyped folder, which would become another leaderboard without a word.
#[test]
fn administration_makes_no_leaderboard_by_accident() {
    let folder = Folder::new("commands-admin");
    let board = folder.0.join("board");
    let admin = |args: &[&str]| scorer(&[&["admin", "--folder", board.to_str().unwrap()], args].concat());
    let (code, _, err) = admin(&["account", "lab"]);
    assert!(code == 1 && err.contains("has no leaderboard; name the folder of `scorer serve`"), "{code}: {err}");
    assert!(!board.exists());
    assert_eq!(admin(&["init"]).0, 0);
    assert_eq!(admin(&["account", "lab"]).0, 0);
    let (code, _, err) = admin(&["token", "lab", "--days", "0"]);
    assert!(code == 2 && err.contains("give a whole number from 1 to 3650"), "{code}: {err}");
}

/// Guards against results that are lost without a word, and against thread counts that mean something else.
#[test]
fn a_full_disk_and_odd_numbers_are_named() {
    let folder = Folder::new("commands-full");
    common::write(&folder.0.join("a.mcap"), Task::S01, 3, Story::Succeeds(30));
    let path = folder.0.to_str().unwrap();
    for args in [&["grade", path][..], &["grade", path, "--json"], &["grade", path, "--csv"]] {
        let full = std::fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
        let output = Command::new(env!("CARGO_BIN_EXE_scorer")).args(args).stdout(full).output().unwrap();
        let err = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.code() == Some(1) && err.contains("cannot be written to stdout: No space"), "{err}");
    }
    for command in [&["grade", path][..], &["serve", "--folder", path]] {
        let (code, _, err) = scorer(&[command, &["--workers", "0"]].concat());
        assert!(code == 2 && err.contains("give a whole number from 1 to 1024"), "{code}: {err}");
    }
}

/// Guards against an interrupt that looks like a fault of the server or, by its exit code, like a forged bag.
#[test]
fn an_interrupted_verification_says_so() {
    let folder = Folder::new("commands-interrupt");
    common::write(&folder.0.join("a.mcap"), Task::S01, 3, Story::Succeeds(30));
    // Nobody listens there, so it waits.
    let args = ["verify", folder.0.to_str().unwrap(), "-e", "tcp/127.0.0.1:9"];
    let mut command = Command::new(env!("CARGO_BIN_EXE_scorer"));
    let child = command.args(args).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    std::thread::sleep(std::time::Duration::from_secs(1));
    assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
    let output = child.wait_with_output().unwrap();
    let err = String::from_utf8(output.stderr).unwrap();
    assert_eq!((output.status.code(), err.as_str()), (Some(130), "interrupted: 1 of 1 bag not simulated again\n"));
}

/// A folder with the `results.json` of one policy, an episode of S01 for each seed.
fn results(folder: &Folder, policy: &str, seeds: u64) -> String {
    let episode =
        |seed| json!({ "task": "S01", "seed": seed, "episode": 0, "success": seed == 0, "gate_progress": 0.5 });
    let results = json!({
        "policy": policy,
        "episodes": (0..seeds).map(episode).collect::<Vec<_>>(),
        "conditions": { "protocol": "published", "time": "lockstep", "sensors": [policy] },
        "versions": { "results": RESULTS_VERSION },
    });
    let path = folder.0.join(policy);
    std::fs::create_dir_all(&path).unwrap();
    std::fs::write(path.join("results.json"), results.to_string()).unwrap();
    path.to_str().unwrap().to_owned()
}

#[test]
fn a_comparison_prints_a_table_or_json() {
    let folder = Folder::new("commands-compare");
    let (a, b) = (results(&folder, "one", 2), results(&folder, "two", 1));
    let (code, out, _) = scorer(&["compare", &a, &a]);
    assert!(code == 0 && out.contains("\nall "), "{out}");
    // One of A has no partner.
    let (code, out, _) = scorer(&["compare", &a, &b, "--json"]);
    let json: Value = serde_json::from_str(&out).unwrap();
    assert_eq!((code, &json["overall"]["pairs"], &json["a"]["unpaired"]), (3, &json!(1), &json!(1)));
    let (code, _, err) = scorer(&["compare", &a, "nowhere"]);
    assert!(code == 1 && err.contains("cannot read nowhere"), "{err}");
    assert_eq!(scorer(&["compare", &a]).0, 2);
}
