//! Bags of forgers, some of whom make every digest anew.

use fiatlux_bag::Bag;
use fiatlux_proto::v3::Sensor;
use fiatlux_rules::errand;
use fiatlux_tests::forge::Parts;

use super::lab::{Board, Lab, played_run};

type Change = fn(&mut Parts, &Parts);

/// Changes, whether the digests are made anew after them, and what the service says of each.
const FORGED: [(&str, bool, Change, &str); 16] = [
    ("a-joint", false, |parts, _| parts.states[7].joint_position[3] += 1e-9, "numbers were changed"),
    ("a-joint-sealed", true, |parts, _| parts.states[7].joint_position[3] += 1e-9, "step 7: joint_position of "),
    ("an-action", true, |parts, _| parts.actions[4].action.as_mut().unwrap().action[3] += 0.5, "step 5: "),
    ("a-bulb", false, |parts, _| move_bulb(parts), "numbers were changed"),
    ("steps", false, remove_steps, "row "),
    ("steps-sealed", true, remove_steps, "row "),
    ("result", false, |parts, _| parts.result.end.as_mut().unwrap().success = true, "end.success is false by its rows"),
    (
        "result-sealed",
        true,
        |parts, _| parts.result.end.as_mut().unwrap().success = true,
        "end.success is false by its rows",
    ),
    ("seed", false, |parts, _| parts.header.seed += 1, "header was changed"),
    ("seed-sealed", true, |parts, _| parts.header.seed += 1, "seed is 0 by the request in it, and 1 in the header"),
    ("seed-requested-sealed", true, request_other_seed, "this one says that they are of S01, seed 1"),
    ("rows", true, |parts, other| parts.states.clone_from(&other.states), "rows"),
    (
        "signature",
        true,
        |parts, other| parts.result.signature.clone_from(&other.result.signature),
        "signature does not fit",
    ),
    ("header", false, |parts, _| parts.header.policy = "best".into(), "header was changed"),
    ("protocol", false, |parts, _| parts.header.episode_protocol = "published".into(), "header was changed"),
    ("sensors", false, |parts, _| parts.header.sensors.retain(|sensor: &Sensor| sensor.bag_only), "header was changed"),
];

fn move_bulb(parts: &mut Parts) {
    parts.states[9].things[errand::FRESH_BULB].position[0] += 0.1;
}

fn request_other_seed(parts: &mut Parts, _: &Parts) {
    parts.header.seed += 1;
    parts.header.request.as_mut().unwrap().seed += 1;
}

fn remove_steps(parts: &mut Parts, _: &Parts) {
    parts.states.drain(10..15);
}

/// Guards that no forged bag is in a table or has a badge, and that its submitter reads where it differs.
#[test]
fn forged_bags_are_refused() {
    let lab = Lab::start("board-forged");
    let run = played_run(&lab, "public", &["--seeds", "0..1"]);
    let bags: Vec<_> = fiatlux_bag::BagFiles::find(&[run]).unwrap().bags;
    let of = |seed: u64| {
        let is_it = |path: &&std::path::PathBuf| {
            let bag = Bag::open(path).unwrap();
            bag.header().task == "S01" && bag.header().seed == seed
        };
        Parts::of(bags.iter().find(is_it).unwrap())
    };
    let (honest, other) = (of(0), of(1));
    let board = Board::start(&lab, &[]);
    let submit = |name: &str, parts: &Parts| {
        let folder = lab.folder().path().join(format!("forged-{name}"));
        std::fs::create_dir_all(&folder).unwrap();
        parts.write(&folder.join("a.mcap"));
        board.submit(&folder, &["--note", name])
    };
    // A forger's starting point: not signed, all digests made anew, and good.
    let mut bare = honest.clone();
    bare.result.signature = None;
    bare.seal();
    let (code, entry) = submit("nothing", &bare);
    assert_eq!((code, &entry["state"], &entry["badge"]), (0, &"verified".into(), &"replayed".into()), "{entry}");
    for (name, seals, change, expected) in FORGED {
        let mut parts = bare.clone();
        change(&mut parts, &other);
        if seals {
            parts.seal();
        }
        let (code, entry) = submit(name, &parts);
        let reason = entry["reason"].as_str().unwrap();
        assert_eq!((code, entry["state"].as_str()), (1, Some("refused")), "{name}: {entry}");
        assert!(reason.contains(expected), "{name}: {reason}");
    }
    // A signed bag of which one bit is another, and the signature of another one on it.
    for (name, change) in [
        ("signed", (|parts, _| parts.result.total_reward += 1.0) as Change),
        ("signed-other", |parts, other| parts.result.signature.clone_from(&other.result.signature)),
    ] {
        let mut parts = honest.clone();
        change(&mut parts, &other);
        let (code, entry) = submit(name, &parts);
        let reason = entry["reason"].as_str().unwrap();
        assert!(code == 1 && reason.contains("signature does not fit"), "{name}: {entry}");
    }
    let listed = board.get("/api/v1/submissions");
    assert_eq!(listed["submissions"].as_array().unwrap().len(), 1, "the honest one alone: {listed}");
}
