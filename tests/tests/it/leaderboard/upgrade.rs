//! A fleet in which servers and scorers of two versions work at the same time.

use std::collections::BTreeSet;
use std::os::unix::fs::PermissionsExt;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use fiatlux_tests::programs::{PATIENCE, Running, Scratch, endpoint, program, wait_until};

use super::lab::{Board, Lab, played_run};

const VERSION: &str = env!("CARGO_PKG_VERSION");

/// A copy of a program that says another version: another second number, also where the compiler has put the first letters of the version
/// into an instruction.
fn other_version(name: &str, folder: &Scratch) -> PathBuf {
    let mut bytes = std::fs::read(program(name)).unwrap();
    let start = &VERSION.as_bytes()[..4];
    let places: Vec<usize> = (0..bytes.len() - 4).filter(|at| bytes[*at..].starts_with(start)).collect();
    assert!(!places.is_empty(), "{name} does not say its version");
    for at in places {
        let second = &mut bytes[at + 2];
        *second = if *second == b'0' { b'1' } else { *second - 1 };
    }
    let path = folder.path().join(format!("{name}-other"));
    std::fs::write(&path, bytes).unwrap();
    std::fs::set_permissions(&path, PermissionsExt::from_mode(0o755)).unwrap();
    path
}

/// Guards an upgrade under way: while submissions wait, servers of another version, whose physics differ, take the place of all but one of
/// the old servers, and a scorer of another version that of the old one. No badge is lost and nothing is refused, also of what is
/// submitted later.
#[test]
fn an_upgrade_costs_no_submission() {
    let is_nightly = std::env::var_os("FIATLUX_ALL_ROOMS").is_some();
    let (waiting, later, pause) =
        if is_nightly { (200, 150, Duration::from_secs(2)) } else { (10, 4, Duration::from_millis(100)) };
    let lab = Lab::start("board-upgrade");
    let run = played_run(&lab, "many", &["--seeds", &format!("0..{}", waiting + later - 1), "--tasks", "S04"]);
    let [scorer, server] = ["scorer", "sim-server"].map(|name| other_version(name, lab.folder()).display().to_string());
    let scene = lab.folder().path().join("scene.toml");
    std::fs::write(&scene, "[bulb]\nmass = 0.036\n").unwrap();
    let (scene, link) = (scene.display().to_string(), endpoint(lab.port()));
    let old = |name: &str| start("sim-server", name, &link, &[], lab.folder());
    let new = |name: &str| start(&server, name, &link, &["--scene", &scene], lab.folder());

    let mut board = Board::start(&lab, &["--server", "fleet-*"]);
    let submitter = board.submitter();
    let submit = |seed: usize| submitter.send(&run.join(format!("test-S04-s{seed}-a1.mcap")), "");
    let mut ids: BTreeSet<String> = (0..waiting).map(submit).collect();
    let verified = |board: &Board<'_>, ids: &BTreeSet<String>| {
        let listed = board.get("/api/v1/submissions");
        let is_done = |entry: &&serde_json::Value| entry["state"] == "verified" && entry["badge"] == "replayed";
        let done = listed["submissions"].as_array().unwrap().iter().filter(is_done);
        done.filter(|entry| ids.contains(entry["id"].as_str().unwrap())).count()
    };
    let start = Instant::now();
    // It is the first, or the old servers may have verified all before it has a bag.
    let new_server = new("fleet-3");
    let has_played = || board.log().contains("it waits for a server of its version");
    wait_until("the new server has played a bag otherwise", PATIENCE, has_played);
    let (mut first, _last) = (old("fleet-1"), old("fleet-2"));
    board.upgrade(&scorer, &[&link]);
    first.signal("TERM");
    assert!(first.finish(PATIENCE).0.success());
    let _first = new("fleet-1");
    for seed in waiting..waiting + later {
        ids.insert(submit(seed));
        std::thread::sleep(pause);
    }
    wait_until("all are verified", 5 * PATIENCE, || verified(&board, &ids) == ids.len());
    let took = start.elapsed().as_secs_f64();
    let log = board.admin(&["log", "--last", "1000000"]);
    assert_eq!((ids.len(), log.matches(": submission refused ").count()), (waiting + later, 0), "{log}");
    drop(new_server);
    println!("{} submissions kept their badges in {took:.0} s with servers of two versions", ids.len());
}

fn start(server: &str, name: &str, link: &str, args: &[&str], folder: &Scratch) -> Running {
    let mut started = Running::start(server, &[&["--name", name, "-e", link], args].concat(), folder);
    started.wait_for(&format!("as {name}"));
    started
}
