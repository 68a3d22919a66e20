//! `fiatlux evaluate`: the same results whatever the number of workers, and however often it is interrupted.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use fiatlux_bag::Bag;
use fiatlux_proto::v3::{EpisodeHeader, EpisodeResult};
use fiatlux_tests::programs::{PATIENCE, Running, Scratch, wait_until};
use serde_json::Value;

fn evaluate(args: &[&str], out: &Path, scratch: &Scratch) -> Running {
    let out = out.display().to_string();
    Running::start("fiatlux", &[&["evaluate", "--out", &out], args].concat(), scratch)
}

fn results(out: &Path) -> Value {
    serde_json::from_slice(&fs::read(out.join("results.json")).unwrap()).unwrap()
}

/// The bags of an evaluation by name, with when they were written.
fn bags(out: &Path) -> Vec<(PathBuf, SystemTime)> {
    let entries = fs::read_dir(out.join("bags")).unwrap().map(Result::unwrap);
    let bags = entries.filter(|entry| entry.path().extension().is_some_and(|extension| extension == "mcap"));
    let mut bags: Vec<_> = bags.map(|bag| (bag.path(), bag.metadata().unwrap().modified().unwrap())).collect();
    bags.sort();
    bags
}

/// Two bags hold the same episode: all is equal but the session's id, which is the server's at that time, and the digest of
/// the header, which has that id.
fn assert_same(left: &Path, right: &Path) {
    let [left, right] = [left, right].map(|path| Bag::open(path).unwrap());
    let without_id = |bag: &Bag| EpisodeHeader { session: String::new(), ..bag.header().clone() };
    assert_eq!(without_id(&left), without_id(&right));
    let without_digest =
        |bag: &Bag| bag.result().cloned().map(|result| EpisodeResult { header_digest: String::new(), ..result });
    assert_eq!((without_digest(&left), left.completeness()), (without_digest(&right), right.completeness()));
    macro_rules! assert_equal {
        ($($topic:ident)*) => {$(
            assert!(left.$topic().map(Result::unwrap).eq(right.$topic().map(Result::unwrap)), stringify!($topic));
        )*};
    }
    assert_equal!(states actions observations rewards events frames scenes);
}

/// Guards that results depend on what is evaluated alone: not on the number of workers, nor on a second call, which finds
/// all episodes done.
#[test]
fn results_do_not_depend_on_the_workers() {
    let scratch = Scratch::new("evaluate");
    let asked = ["--policy", "zero", "--tasks", "S01,S08", "--seeds", "0..1"];
    let [one, two] = ["1", "2"].map(|workers| {
        let out = scratch.path().join(workers);
        let (status, _) = evaluate(&[&asked[..], &["--workers", workers]].concat(), &out, &scratch).finish(PATIENCE);
        assert!(status.success(), "{status}");
        out
    });
    for name in ["results.json", "report.html"] {
        assert!(fs::read(one.join(name)).unwrap() == fs::read(two.join(name)).unwrap(), "{name} differs");
    }
    // A still of each episode is in the report, one click from its replay.
    let report = fs::read_to_string(one.join("report.html")).unwrap();
    for episode in ["S01-s0-e0", "S01-s1-e0", "S08-s0-e0", "S08-s1-e0"] {
        let still =
            format!("<a class=\"still\" href=\"replays/{episode}.html\"><img src=\"data:image/png;base64,iVBOR");
        assert!(report.contains(&still), "{episode}");
        assert!(fs::read_to_string(one.join(format!("replays/{episode}.html"))).unwrap().contains("block-track.bin"));
    }
    let written = bags(&one);
    assert_eq!(written.len(), 4);
    for ((left, _), (right, _)) in written.iter().zip(&bags(&two)) {
        assert_eq!(left.file_name(), right.file_name());
        assert_same(left, right);
    }

    let before = fs::read(one.join("results.json")).unwrap();
    let mut again = evaluate(&asked, &one, &scratch);
    assert!(again.finish(PATIENCE).0.success());
    assert!(again.log().contains("4 episodes were already in "), "{}", again.log());
    assert_eq!(bags(&one), written, "no bag is written again");
    assert_eq!(fs::read(one.join("results.json")).unwrap(), before);
}

/// Guards that the result of a relay says whose it is, and that the expert's own evaluation does not go on with it.
#[test]
fn a_relay_has_a_result_of_its_own() {
    let scratch = Scratch::new("relay");
    let out = scratch.path().join("out");
    let asked = ["--policy", "expert", "--with", "S01=zero", "--seeds", "0", "--bags", "thin"];
    let (status, table) = evaluate(&asked, &out, &scratch).finish(PATIENCE);
    assert!(status.success() && table.contains("S01=zero") && table.contains("NOT RANKED"), "{table}");
    let results = results(&out);
    assert_eq!(
        (&results["policy"], &results["episodes"][0]["task"]),
        (&"expert with S01=zero".into(), &"replace".into())
    );
    assert_eq!((&results["parts"][0]["policy"], &results["parts"][0]["reached"]), (&"zero".into(), &1.into()));
    assert_eq!((&results["parts"][0]["successes"], &results["parts"][1]["reached"]), (&0.into(), &0.into()));
    let plain = ["--policy", "expert", "--tasks", "replace", "--seeds", "0", "--bags", "thin"];
    let mut other = evaluate(&plain, &out, &scratch);
    assert!(!other.finish(PATIENCE).0.success() && other.log().contains("expert with S01=zero"), "{}", other.log());
}

/// Guards the report of a folder: a second call with other tasks and seeds adds to it. What is not an episode of the
/// evaluation is refused by name.
#[test]
fn a_report_is_of_its_whole_folder() {
    let scratch = Scratch::new("folder");
    let out = scratch.path().join("out");
    for (tasks, seeds) in [("S01,S08", "0..1"), ("S08", "7"), ("S01", "1")] {
        let asked = ["--policy", "zero", "--tasks", tasks, "--seeds", seeds];
        assert!(evaluate(&asked, &out, &scratch).finish(PATIENCE).0.success());
        // What programs and file systems leave next to a bag is none.
        for name in ["~$S08-s7-e0.mcap", "._S08-s7-e0.mcap"] {
            fs::write(out.join("bags").join(name), "a lock").unwrap();
        }
    }
    let results = results(&out);
    let episodes: Vec<_> = results["episodes"].as_array().unwrap().iter().map(|e| (&e["task"], &e["seed"])).collect();
    assert_eq!(episodes.len(), 5, "{episodes:?}");
    assert_eq!(bags(&out).len(), 5 + 2, "with those two");
    let without = |ran: &[&str]| -> Value {
        let subtasks = (1..=12).map(|number| format!("S{number:02}"));
        subtasks.filter(|task| !ran.contains(&task.as_str())).collect()
    };
    assert_eq!(results["missing"], without(&["S08"]), "seed 7 has S08 alone");
    let per_seed = results["score"]["per_seed"].as_array().unwrap();
    let lacking: Vec<_> = per_seed.iter().map(|row| (row["seed"].as_u64().unwrap(), row["missing"].clone())).collect();
    let both = without(&["S01", "S08"]);
    assert_eq!(lacking, [(0, both.clone()), (1, both), (7, without(&["S08"]))]);

    fs::copy(out.join("bags/S08-s7-e0.mcap"), out.join("bags/copy.mcap")).unwrap();
    let mut again = evaluate(&["--policy", "zero", "--tasks", "S01", "--seeds", "1"], &out, &scratch);
    assert_eq!(again.finish(PATIENCE).0.code(), Some(1));
    assert!(again.log().contains("copy.mcap: it is not an episode of an evaluation"), "{}", again.log());
}

/// Guards Ctrl-C: an evaluation ends soon, what is finished is graded and kept, and the same command does the rest.
#[test]
fn an_interrupted_evaluation_is_resumed() {
    let scratch = Scratch::new("interrupt");
    let out = scratch.path().join("out");
    let asked = ["--policy", "stand", "--tasks", "S05", "--seeds", "0..2"];
    let mut first = evaluate(&[&asked[..], &["--workers", "1"]].concat(), &out, &scratch);
    let (done, begun) = (out.join("bags/S05-s0-e0.mcap"), out.join("bags/S05-s1-e0.mcap.part"));
    wait_until("one episode is done and the next one has begun", PATIENCE, || done.exists() && begun.exists());
    first.signal("INT");
    let (status, _) = first.finish(Duration::from_secs(15));
    assert_eq!(status.code(), Some(3), "finished with episodes that are missing");
    assert!(first.log().contains("played, the rest will be played by the same command"), "{}", first.log());
    let seeds = |results: &Value| results["episodes"].as_array().unwrap().iter().map(|e| e["seed"].clone()).collect();
    let graded: Vec<Value> = seeds(&results(&out));
    assert_eq!(graded, [0]);
    let kept = bags(&out).remove(0);

    let mut second = evaluate(&[&asked[..], &["--workers", "2"]].concat(), &out, &scratch);
    assert!(second.finish(PATIENCE).0.success());
    assert!(second.log().contains("1 episode was already in "), "{}", second.log());
    let graded: Vec<Value> = seeds(&results(&out));
    assert_eq!(graded, [0, 1, 2]);
    assert_eq!(bags(&out)[0], kept, "what was done is not done again");
}

/// Guards rooms in which `walk` struck or lost its bulb at the ladder, past a corner or for want of a path that is long enough.
/// No force may come near the 50 N that break a bulb.
#[test]
fn walk_brings_its_bulb_to_the_ladder_unharmed() {
    let scratch = Scratch::new("walk");
    let out = scratch.path().join("out");
    let asked = ["--policy", "walk", "--tasks", "S09", "--seeds", "189,231,306"];
    assert!(evaluate(&asked, &out, &scratch).finish(PATIENCE).0.success());
    let results = results(&out);
    let episodes = results["episodes"].as_array().unwrap();
    assert_eq!(episodes.len(), 3);
    for episode in episodes {
        let force = episode["peak_hand_force_n"].as_f64().unwrap();
        assert!(episode["strict_success"] == true && episode["strict_clean"] == true && force < 30.0, "{episode}");
    }
}
