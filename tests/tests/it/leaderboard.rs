//! The leaderboard as a process, with servers that verify.

mod forged;
mod group;
mod kills;
mod lab;
mod make;
mod restored;
mod trust;
mod upgrade;

use std::path::{Path, PathBuf};
use std::process::Command;

use fiatlux_access::Identity;
use fiatlux_tests::forge::JournalParts;
use fiatlux_tests::programs::{PATIENCE, Running, endpoint, program, wait_until};
use lab::{Board, played_run};
use serde_json::Value;

/// Guards what a badge stands for: a run is *replayed* once all its bags were simulated again, *hosted* where also its seeds
/// were drawn and its bags signed by the board's own server, and by nobody else.
#[test]
fn runs_get_the_badges_that_they_earn() {
    let lab = lab::Lab::start("board-badges");
    let public = played_run(&lab, "public", &["--seeds", "0..3"]);
    let hosted = played_run(&lab, "hosted", &["--hosted", "4"]);
    let known = lab.known_servers();
    let board = Board::start(&lab, &["--signers", &known.display().to_string()]);
    // As the program sends them by default: without their rows.
    let thin = ["--bags", "thin"];
    let (code, first) = board.submit(&public, &thin);
    assert_eq!(
        (code, first["state"].as_str(), first["badge"].as_str()),
        (0, Some("verified"), Some("replayed")),
        "{first}"
    );
    assert_eq!((&first["episodes_verified"], &first["episodes_to_verify"]), (&48.into(), &48.into()));
    let (code, second) = board.submit(&hosted, &thin);
    assert_eq!((code, second["badge"].as_str()), (0, Some("hosted")), "{second}");
    let listed = board.get("/api/v1/submissions");
    let divisions: Vec<&Value> =
        listed["submissions"].as_array().unwrap().iter().map(|entry| &entry["division"]).collect();
    let [of_public, of_hosted] = [
        serde_json::json!({ "table": "replayed", "robot": "g1_inspire" }),
        serde_json::json!({ "table": "hosted", "time": "lockstep", "observations": "standard", "robot": "g1_inspire" }),
    ];
    assert_eq!(divisions, [&of_public, &of_hosted], "{listed}");
    let proofs = |entry: &Value| ["rows", "senses", "tries"].map(|claim| entry["claims"][claim]["proof"].clone());
    let listed = listed["submissions"].as_array().unwrap();
    assert_eq!(proofs(&listed[0]), ["proven", "claimed", "claimed"], "{}", listed[0]);
    // This board does not read its servers' journals, so it cannot count other runs.
    assert_eq!(proofs(&listed[1]), ["proven", "proven", "claimed"], "{}", listed[1]);

    // Bags whose journal is left out are loose ones: replayed at most, and in no fixed rooms.
    let loose = lab.copy(&hosted, "loose", |name| name.ends_with(".mcap"));
    let (_, third) = board.submit(&loose, &[]);
    assert_eq!(third["badge"], "replayed", "{third}");
    let third = board.get(&format!("/api/v1/submissions/{}", third["id"].as_str().unwrap()));
    assert_eq!(
        (&third["division"], &third["not_ranked"]),
        (&Value::Null, &"its journal is missing: episodes may have been left out".into())
    );
    // One bag less is a run whose bag is lost.
    let lost = lab.copy(&hosted, "lost", |name| !name.contains("-S05-"));
    let (code, fourth) = board.submit(&lost, &[]);
    assert_eq!((code, fourth["state"].as_str()), (1, Some("refused")));
    assert!(fourth["reason"].as_str().unwrap().contains("its bag is missing"), "{fourth}");
    // A journal that was written anew: its chain breaks.
    let forged = lab.copy(&public, "forged", |_| true);
    let journal = std::fs::read_dir(&forged).unwrap().map(|entry| entry.unwrap().path());
    let journal: PathBuf = journal.into_iter().find(|path| path.to_string_lossy().ends_with(".run.jsonl")).unwrap();
    let text = std::fs::read_to_string(&journal).unwrap();
    std::fs::write(&journal, text.replacen("\"hosted_seeds\":0", "\"hosted_seeds\":1", 1)).unwrap();
    let (code, fifth) = board.submit(&forged, &[]);
    assert_eq!((code, fifth["state"].as_str()), (1, Some("refused")), "{fifth}");
}

/// Guards a group of servers: one that joins it verifies what waits, without a restart of the board.
#[test]
fn a_server_that_joins_a_group_verifies() {
    let lab = lab::Lab::start("board-group");
    let run = played_run(&lab, "one", &["--seeds", "0..0", "--tasks", "S07"]);
    let board = Board::start(&lab, &["--server", "test-*"]);
    let (code, entry) = board.submit_without_waiting(&run);
    assert_eq!(code, 0, "{entry}");
    let at = format!("/api/v1/submissions/{}", entry["id"].as_str().unwrap());
    let state = || board.get(&at)["state"].as_str().unwrap_or_default().to_owned();
    wait_until("it is graded", PATIENCE, || state() == "graded");
    let link = endpoint(lab.port());
    let mut joins = Running::start("sim-server", &["--name", "test-2", "-e", &link], lab.folder());
    joins.wait_for("as test-2");
    wait_until("it is verified", PATIENCE, || state() == "verified");
    let mut wrong =
        Running::start("scorer", &["work", "--folder", "board", "-e", &link, "--server", "*"], lab.folder());
    assert_eq!(wrong.finish(PATIENCE).0.code(), Some(2));
    assert!(wrong.log().contains("NAME-* stands for all whose names begin with NAME-"), "{}", wrong.log());
}

/// Guards that signed bags with another journal than the server's are not hosted: one that ends early, lacks an episode, or is
/// signed by somebody else. Otherwise whoever has the bags could leave out what went badly.
#[test]
fn a_hosted_run_is_hosted_as_a_whole() {
    let lab = lab::Lab::start("board-whole");
    let hosted = played_run(&lab, "hosted", &["--hosted", "1"]);
    let known = lab.known_servers();
    let board = Board::start(&lab, &["--signers", &known.display().to_string()]);
    let journal = fiatlux_bag::run::journals(&hosted).unwrap().remove(0);
    let honest = JournalParts::of(&journal);
    let stranger = Identity::generate().unwrap();
    let last = honest.registration.episodes.len() as u32 - 1;
    type Change = fn(&mut JournalParts, u32);
    let forge = |name: &str, change: Change, signer: Option<&Identity>| {
        let folder = lab.copy(&hosted, name, |file| file.ends_with(".mcap"));
        let mut parts = honest.clone();
        change(&mut parts, last);
        let written = parts.write(&folder, signer);
        (folder, written)
    };
    let forged: [(&str, Change, Option<&Identity>); 5] = [
        ("unsigned", |_, _| {}, None),
        ("cut", |parts, last| parts.drop_events_of(last), None),
        ("shortened", |parts, _| parts.drop_last_episode(), None),
        ("signed-cut", |parts, last| parts.drop_events_of(last), Some(&stranger)),
        ("signed-shortened", |parts, _| parts.drop_last_episode(), Some(&stranger)),
    ];
    for (name, change, signer) in forged {
        let (folder, _) = forge(name, change, signer);
        let (code, entry) = board.submit(&folder, &["--note", name]);
        assert_eq!((code, entry["badge"].as_str()), (0, Some("replayed")), "{name}: {entry}");
        // The next one has some of its episodes.
        board.remove(&entry);
    }
    // The server's own signature under other lines.
    let seal = std::fs::read_to_string(&journal).unwrap().lines().last().unwrap().to_owned();
    assert!(seal.contains("\"event\":\"sealed\""), "{seal}");
    let (folder, written) = forge("copied", |parts, _| parts.drop_last_episode(), None);
    let text = std::fs::read_to_string(&written).unwrap();
    std::fs::write(&written, format!("{text}{seal}\n")).unwrap();
    let (code, entry) = board.submit(&folder, &[]);
    assert_eq!((code, entry["state"].as_str()), (1, Some("refused")), "{entry}");
    // As the server left it.
    let (code, entry) = board.submit(&hosted, &[]);
    assert_eq!((code, entry["badge"].as_str()), (0, Some("hosted")), "{entry}");
}

/// Guards that a service without trusted keys calls nothing hosted, and that episodes wait while no server verifies.
#[test]
fn nothing_is_hosted_by_its_own_word() {
    let lab = lab::Lab::start("board-word");
    let hosted = played_run(&lab, "hosted", &["--hosted", "1"]);
    let mut board = Board::start_with(&lab, &[], &[]);
    let (code, accepted) = board.submit_without_waiting(&hosted);
    assert_eq!(code, 0);
    let id = accepted["id"].as_str().unwrap();
    lab::wait_for_state(&board, id, "graded");
    let entry = board.get(&format!("/api/v1/submissions/{id}"));
    assert_eq!((&entry["badge"], &entry["episodes_verified"]), (&"self_reported".into(), &0.into()), "{entry}");
    board.restart(&[&endpoint(lab.port())]);
    lab::wait_for_state(&board, id, "verified");
    assert_eq!(board.get(&format!("/api/v1/submissions/{id}"))["badge"], "replayed");
}

/// Size of the one bag in a store, bytes, and whether it is thin.
fn only_bag(store: &Path) -> (u64, bool) {
    let folders = std::fs::read_dir(store.join("blobs")).unwrap().map(|folder| folder.unwrap().path());
    let files = folders.flat_map(|folder| std::fs::read_dir(folder).unwrap()).map(|file| file.unwrap().path());
    let bags =
        files.filter_map(|path| Some((path.metadata().unwrap().len(), fiatlux_bag::Bag::open(&path).ok()?.is_thin())));
    let bags: Vec<_> = bags.collect();
    assert_eq!(bags.len(), 1);
    bags[0]
}

/// Guards several scorers on one folder: what one accepts, another grades, a third one verifies, and both services show.
#[test]
fn scorers_share_a_folder() {
    let lab = lab::Lab::start("board-shared");
    let run = played_run(&lab, "public", &["--seeds", "0", "--tasks", "S04"]);
    let mut first = Board::start_with(&lab, &[], &[]);
    let second = first.another();
    let (code, accepted) = first.submit_without_waiting(&run);
    assert_eq!(code, 0);
    let id = accepted["id"].as_str().unwrap();
    first.stop();
    lab::wait_for_state(&second, id, "graded");
    let (folder, server) = (second.folder().display().to_string(), endpoint(lab.port()));
    let mut worker = Running::start("scorer", &["work", "--folder", &folder, "-e", &server], lab.folder());
    worker.wait_for("working on");
    lab::wait_for_state(&second, id, "verified");
    first.restart(&[]);
    assert_eq!(first.get(&format!("/api/v1/submissions/{id}"))["badge"], "replayed");
    worker.signal("TERM");
    assert!(worker.finish(PATIENCE).0.success());
    // What is old and verified needs no rows on the disk.
    let thin = |older: &str| {
        let args = ["admin", "--folder", &folder, "thin", "--older", older];
        String::from_utf8(Command::new(program("scorer")).args(args).output().unwrap().stdout).unwrap()
    };
    let (full, is_thin) = only_bag(&first.folder());
    assert!(!is_thin);
    assert_eq!(thin("1d"), "0 bags made thin: 0.0 MiB before, 0.0 MiB after\n");
    let said = thin("0d");
    assert!(said.starts_with("1 bag made thin") && said.lines().count() == 1, "{said}");
    let (left, is_thin) = only_bag(&first.folder());
    assert!(is_thin && left < full, "{left} of {full} bytes");
    assert!(thin("0d").starts_with("0 bags made thin"));
    let page = String::from_utf8(first.fetch(&format!("/runs/{id}/episodes/S04-s0-e0"))).unwrap();
    assert!(page.contains("with-replay"), "{page}");
    let nobody = Running::start("scorer", &["work", "--folder", &folder], lab.folder()).finish(PATIENCE).0;
    assert_eq!(nobody.code(), Some(1), "a worker without a server has nothing to do");
}

/// Guards that the Python module sends what the service takes.
#[test]
#[ignore = "needs Python's libraries: tests/run"]
fn python_submits_too() {
    let python = std::env::var("FIATLUX_PYTHON").expect("FIATLUX_PYTHON names a Python; tests/run makes one");
    let lab = lab::Lab::start("board-python");
    let run = played_run(&lab, "public", &["--seeds", "0"]);
    let board = Board::start(&lab, &[]);
    let module = concat!(env!("CARGO_MANIFEST_DIR"), "/../python/fiatlux/submission.py");
    let script = "import importlib.util, json, sys; s = importlib.util.spec_from_file_location('submission', sys.argv[1]); \
                  m = importlib.util.module_from_spec(s); s.loader.exec_module(m); \
                  print(json.dumps(m.submit(sys.argv[2], sys.argv[3], sys.argv[4], policy='random', wait=True)))";
    let token = std::fs::read_to_string(board.token()).unwrap();
    let done = Command::new(python)
        .args(["-c", script, module])
        .arg(&run)
        .args([board.url().as_str(), token.trim()])
        .output()
        .unwrap();
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    let sent: Value = serde_json::from_slice(&done.stdout).unwrap();
    assert_eq!((&sent["state"], &sent["badge"]), (&"verified".into(), &"replayed".into()), "{sent}");
}
