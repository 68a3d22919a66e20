//! The attacks A1 to A10 on the meaning of a rank, with digests made anew: a changed label gains no place, and each answer says
//! why.

use std::path::{Path, PathBuf};

use fiatlux_access::sign_result;
use fiatlux_bag::BagFiles;
use fiatlux_bag::run::{Ledger, LedgerWriter, journals};
use fiatlux_proto::v3::{Asset, Mode, Sensor, Source};
use fiatlux_rules::pins;
use fiatlux_tests::forge::Parts;
use serde_json::{Value, json};

use super::lab::{Board, Lab, played_by, played_run};

/// The bags of a run, forged: not signed, in no run, changed, with all digests made anew.
fn forged(lab: &Lab, run: &Path, name: &str, change: impl Fn(&mut Parts)) -> PathBuf {
    let folder = lab.folder().path().join(format!("forged-{name}"));
    std::fs::create_dir_all(&folder).unwrap();
    for bag in BagFiles::find(&[run.to_path_buf()]).unwrap().bags {
        let mut parts = Parts::of(&bag);
        parts.result.signature = None;
        parts.header.run = None;
        // A session of the forger's own: the file is another one.
        parts.header.session = format!("{name}-1");
        change(&mut parts);
        parts.seal();
        parts.write(&folder.join(bag.file_name().unwrap()));
    }
    folder
}

fn rename(parts: &mut Parts, policy: &str) {
    parts.header.policy = policy.into();
    parts.header.request.as_mut().unwrap().policy = policy.into();
}

/// As a bag of the real-time mode says of itself.
fn in_real_time(parts: &mut Parts) {
    parts.header.mode = Mode::RealTime.into();
    parts.header.command_timeout_s = 0.5;
    parts.header.request.as_mut().unwrap().mode = Mode::RealTime.into();
}

/// The entry as everybody sees it, or as its submitter does.
fn entry(board: &Board<'_>, said: &Value) -> Value {
    board.get(&format!("/api/v1/submissions/{}", said["id"].as_str().unwrap()))
}

fn assert_refused(name: &str, (code, said): (i32, Value), reason: &str) {
    assert_eq!((code, said["state"].as_str()), (1, Some("refused")), "{name}: {said}");
    assert!(said["reason"].as_str().unwrap().contains(reason), "{name}: {said}");
}

/// Guards that labels gain nothing (A1), and that rows have one owner, one name and one room (A2, A3, A6).
#[test]
fn labels_gain_no_place() {
    let lab = Lab::start("trust-labels");
    let run = played_run(&lab, "public", &["--seeds", "0..3", "--sensors", "proprioception,privileged"]);
    let board = Board::start(&lab, &["--refusal-pause", "0"]);

    // A1: privileged bags say that they are another policy's, with standard sensors.
    let standard = |parts: &mut Parts| {
        rename(parts, "nova-vla");
        let names = ["proprioception", "last_action"];
        let sensors = names.map(|name| Sensor { name: name.into(), rate_hz: 50.0, ..Sensor::default() });
        parts.header.sensors = sensors.to_vec();
        parts.header.request.as_mut().unwrap().sensors = sensors.to_vec();
    };
    let (code, said) = board.submit_as("forger", &forged(&lab, &run, "a1", standard), &[]);
    assert_eq!((code, &said["badge"]), (0, &json!("replayed")), "{said}");
    let a1 = entry(&board, &said);
    assert_eq!(a1["claims"]["senses"]["proof"], "claimed", "{a1}");
    board.remove(&said);
    // The true label has the same place.
    let (code, said) = board.submit(&run, &[]);
    assert_eq!((code, &said["badge"]), (0, &json!("replayed")), "{said}");
    let honest = entry(&board, &said);
    assert_eq!(
        (&a1["division"], &honest["division"]),
        (&json!({ "table": "replayed", "robot": "g1_inspire" }), &a1["division"])
    );
    let page = String::from_utf8(board.fetch("/")).unwrap();
    assert!(page.contains("proof-claimed") && !page.contains("proof-proven\" title=\"standard"), "{page}");

    // A1 again, now that the rows are known; A6: the same actions in a session of another's own.
    let first = said["id"].as_str().unwrap();
    let taken = format!("already submitted as {first} by lab");
    assert_refused("a1", board.submit_as("forger", &forged(&lab, &run, "a1-again", standard), &[]), &taken);
    assert_refused("a6", board.submit_as("forger", &forged(&lab, &run, "a6", |_| {}), &[]), &taken);
    assert_refused(
        "a6 by name",
        board.submit(&forged(&lab, &run, "a6-name", standard), &[]),
        "one of the two is wrong",
    );
    // A3: as real time.
    assert_refused("a3", board.submit_as("forger", &forged(&lab, &run, "a3", in_real_time), &[]), &taken);
    // A2: rows of room 0 said to be of others, in a request that no server accepts.
    let moved = |parts: &mut Parts| {
        parts.header.seed += 64;
        let request = parts.header.request.as_mut().unwrap();
        request.seed += 64;
        (request.image_width, parts.header.image_width) = (7, 7);
    };
    assert_refused("a2", board.submit_as("forger", &forged(&lab, &run, "a2", moved), &[]), "image_width is 7 pixels");
    let listed = board.get("/api/v1/submissions");
    assert_eq!(listed["submissions"].as_array().unwrap().len(), 1, "the honest one alone: {listed}");
}

/// Guards that bags which nobody can simulate again have no rank (A2, A3, A8), that a person has none (A5, A7), and that built-in
/// policies belong to the first who sends them.
#[test]
fn what_cannot_be_compared_is_not_ranked() {
    let lab = Lab::start("trust-fresh");
    let run = played_by(&lab, "random", "fresh", &["--tasks", "S01", "--seeds", "0..3"]);
    let board = Board::start(&lab, &["--refusal-pause", "0"]);
    // A2 with a request that servers accept: the rows are not those of the room.
    let moved = |parts: &mut Parts| {
        parts.header.seed += 64;
        parts.header.request.as_mut().unwrap().seed += 64;
    };
    assert_refused("a2", board.submit(&forged(&lab, &run, "a2", moved), &[]), "in the second run");
    assert_refused("a3", board.submit(&forged(&lab, &run, "a3", in_real_time), &[]), "no action took a time");
    // With times of its own it has the place of its true label: one table, and the time is a claim.
    let late = |parts: &mut Parts| {
        in_real_time(parts);
        parts.actions.iter_mut().for_each(|action| action.lateness_s = 0.004);
    };
    let (code, said) = board.submit(&forged(&lab, &run, "a3-late", late), &[]);
    assert_eq!((code, &said["badge"]), (0, &json!("replayed")), "{said}");
    let real_time = entry(&board, &said);
    assert!(real_time["claims"]["rows"]["reason"].as_str().unwrap().contains("in lockstep"), "{real_time}");
    assert!(real_time["claims"]["senses"]["reason"].as_str().unwrap().contains("real time"), "{real_time}");
    board.remove(&said);
    // A8: an object with a made-up digest.
    let object = |parts: &mut Parts| {
        parts.header.assets = vec![Asset { place: "crate".into(), digest: "ab".repeat(32), ..Asset::default() }];
        parts.header.base_scene_digest = pins::SCENE.into();
    };
    assert_refused("a8", board.submit(&forged(&lab, &run, "a8", object), &[]), "does not have the bag's objects");
    // A7: a tracked person by the shipped client.
    const TRACKED: &str = "sonic:models,stream=tcp://192.0.2.1:5555";
    let (_, said) = board.submit(&forged(&lab, &run, "a7", |parts| rename(parts, TRACKED)), &[]);
    let tracked = entry(&board, &said);
    assert_eq!(
        (&tracked["division"], &tracked["claims"]["senses"]["proof"]),
        (&Value::Null, &json!("refused")),
        "{tracked}"
    );
    assert!(tracked["not_ranked"].as_str().unwrap().contains("a person drove it"), "{tracked}");
    // A5: what was known as a person's stays one.
    assert_refused("a5", board.submit_as("other", &forged(&lab, &run, "a5", |_| {}), &[]), "as those of a person");

    // Two honest accounts that send the built-in policy: the first owns its rows.
    let built_in = played_by(&lab, "random", "built-in", &["--tasks", "S02", "--seeds", "0..3"]);
    let (code, said) = board.submit(&built_in, &[]);
    assert_eq!((code, &entry(&board, &said)["ranked_tasks"]), (0, &json!(["S02"])), "{said}");
    let again = played_by(&lab, "random", "built-in-again", &["--tasks", "S02", "--seeds", "0..3"]);
    let taken = format!(
        "already submitted as {} by lab, policy 'random'; the first submission keeps its place",
        said["id"].as_str().unwrap()
    );
    assert_refused("built-in", board.submit_as("other", &again, &[]), &taken);
    // The account's own second run of it takes the place of the first.
    let (code, said) = board.submit(&again, &[]);
    assert_eq!((code, &said["badge"]), (0, &json!("replayed")), "{said}");
    assert_eq!(entry(&board, &said)["ranked_tasks"], json!(["S02"]));
}

/// Guards that a person has no rank in a hosted run either, though a known server has signed journal and bags (A7): servers refuse
/// hosted seeds to a session that says so, and the board asks the bags.
#[test]
fn a_hosted_run_of_a_person_is_not_ranked() {
    let lab = Lab::start("trust-person");
    let hosted = played_by(&lab, "random", "hosted", &["--hosted", "4", "--tasks", "S05"]);
    let board = Board::start(&lab, &["--signers", &lab.known_servers().display().to_string()]);
    let signer = lab.identity();
    let signed = |name: &str, change: fn(&mut Parts)| {
        let folder = lab.copy(&hosted, name, |file| !file.ends_with(".mcap"));
        for bag in BagFiles::find(std::slice::from_ref(&hosted)).unwrap().bags {
            let mut parts = Parts::of(&bag);
            change(&mut parts);
            parts.seal();
            sign_result(&signer, &mut parts.result);
            parts.write(&folder.join(bag.file_name().unwrap()));
        }
        folder
    };
    let folder = signed("source", |parts| {
        parts.header.source = Source::Person.into();
        parts.header.request.as_mut().unwrap().source = Source::Person.into();
    });
    let (_, said) = board.submit_as("source", &folder, &[]);
    let entry = entry(&board, &said);
    assert!(entry["division"].is_null() && entry["ranked_tasks"] == json!([]), "{entry}");
    let why = [&entry["not_ranked"], &entry["reason"]].map(|text| text.as_str().unwrap_or_default()).concat();
    assert!(why.contains("a person"), "{entry}");
    // A tracked body under the name of a policy that was registered: the journal, which the server signed, has another.
    let folder = signed("stream", |parts| rename(parts, "sonic:models,stream=tcp://192.0.2.1:5555"));
    assert_refused("stream", board.submit_as("stream", &folder, &[]), "the bag is not the one in the journal");
    // The policy's own bags are ranked no more: their rows are a person's.
    assert_refused("as a policy", board.submit(&hosted, &[]), "as those of a person");
}

/// Guards that the best of three registered hosted runs is not ranked as the only one (A10).
#[test]
fn registered_runs_count() {
    let lab = Lab::start("trust-tries");
    let shown = ["--sensors", "proprioception,goal"];
    let hosted = played_by(&lab, "random", "hosted", &[&["--hosted", "4", "--tasks", "S05"], &shown[..]].concat());
    // Two more of the same policy and version were registered weeks ago, and nobody submitted them.
    let runs = lab.folder().path().join("runs-of-the-board");
    let name = hosted.file_name().unwrap();
    std::fs::create_dir_all(runs.join(name)).unwrap();
    let journal = journals(&hosted).unwrap().remove(0);
    std::fs::copy(&journal, runs.join(name).join(journal.file_name().unwrap())).unwrap();
    for other in ["second", "third"] {
        let mut registration = Ledger::read(&journal).unwrap().registration().clone();
        registration.run = other.into();
        registration.unix_ms = 1_000_000_000_000;
        LedgerWriter::create(&runs.join(other), registration).unwrap();
    }
    let [signers, runs] = [lab.known_servers(), runs].map(|path| path.display().to_string());
    let board = Board::start(&lab, &["--signers", &signers, "--runs", &runs]);
    let (code, said) = board.submit(&hosted, &[]);
    assert_eq!((code, &said["badge"]), (0, &json!("hosted")), "{said}");
    let said = entry(&board, &said);
    assert_eq!(said["division"]["observations"], "goal", "{said}");
    assert_eq!(
        (&said["claims"]["tries"]["proof"], &said["ranked_tasks"]),
        (&json!("proven"), &json!(["S05"])),
        "{said}"
    );
    let tries = "1 of 3 hosted runs of this policy and version were submitted; 2 count as failures";
    assert_eq!(said["claims"]["tries"]["reason"], tries, "{said}");
}
