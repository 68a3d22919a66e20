//! `scorer verify` on bags of a forger who makes every digest anew: only the second run finds him, and says where.

use std::path::Path;

use fiatlux_proto::v3::Mode;
use fiatlux_tests::forge::Parts;
use fiatlux_tests::programs::{PATIENCE, Running, Service, endpoint, grade};

/// The exit code of `scorer verify`, and what it says.
fn verify(service: &Service, bag: &Path) -> (Option<i32>, String) {
    verify_with(service, bag, &[])
}

fn verify_with(service: &Service, bag: &Path, options: &[&str]) -> (Option<i32>, String) {
    let (bag, endpoint) = (bag.display().to_string(), endpoint(service.port));
    let args = [&["verify", &bag, "-e", &endpoint], options].concat();
    let mut scorer = Running::start("scorer", &args, &service.folder);
    let (status, text) = scorer.finish(PATIENCE);
    (status.code(), format!("{text}\n{}", scorer.log()))
}

#[test]
fn a_second_run_names_what_a_forger_changed() {
    let service = Service::start("verify", &[]);
    let mut recorder = service.record();
    service.play(&["--policy", "random", "--task", "S01", "--seed", "3", "--recorded"]);
    recorder.wait_for(".mcap");
    let bag = service.folder.files(".mcap").remove(0);
    let forged = |name: &str, change: &dyn Fn(&mut Parts)| {
        let mut parts = Parts::of(&bag);
        change(&mut parts);
        parts.seal();
        parts.write(&service.folder.path().join(format!("{name}.mcap")))
    };
    let same = forged("same", &|_| ());
    assert_eq!(grade(&same, &service.folder).0, 0);
    let (code, text) = verify(&service, &same);
    assert!(code == Some(0) && text.starts_with("equal: "), "{text}");

    let knee = Parts::of(&bag).header.joint_names[3].clone();
    type Change = Box<dyn Fn(&mut Parts)>;
    let cases: [(&str, Change, String); 6] = [
        (
            "row",
            Box::new(|parts: &mut Parts| parts.states[7].joint_effort[3] += 1e-12),
            format!("row 7: joint_effort of {knee} is "),
        ),
        (
            "model",
            Box::new(|parts: &mut Parts| parts.header.model_digest = "0".repeat(64)),
            format!("header: model_digest is {} in the bag", "0".repeat(64)),
        ),
        (
            "scene",
            Box::new(|parts: &mut Parts| parts.header.scene_config = "# nothing".into()),
            "header: scene_config is # nothing in the bag".into(),
        ),
        (
            "geometry",
            Box::new(|parts: &mut Parts| parts.header.geometry.as_mut().unwrap().robot_mass += 1.0),
            "header: geometry.robot_mass is ".into(),
        ),
        (
            "drives",
            Box::new(|parts: &mut Parts| parts.header.drives[3].armature *= 2.0),
            "header: drives[3].armature is ".into(),
        ),
        (
            "action",
            Box::new(|parts: &mut Parts| parts.actions[4].action.as_mut().unwrap().action[3] += 0.5),
            "row 5: ".into(),
        ),
    ];
    for (name, change, expected) in cases {
        let forged = forged(name, &change);
        assert_eq!(grade(&forged, &service.folder).0, 0, "{name}: no digest shows it");
        let (code, text) = verify(&service, &forged);
        assert!(code == Some(4) && text.starts_with("different") && text.contains(&expected), "{name}: {text}");
        assert!(text.contains(" in the second run"), "{name}: {text}");
    }

    // Faults of the bag itself are reported before anything is run.
    type Lie = fn(&mut Parts);
    let lies: [(&str, Lie, &str); 4] = [
        ("success", |parts| parts.result.end.as_mut().unwrap().success = true, "end.success is false by its rows"),
        ("zero", |parts| parts.header.model_digest = "0".repeat(64), "header was changed"),
        ("time", |parts| parts.header.mode = Mode::RealTime.into(), "header was changed"),
        ("senses", |parts| parts.header.sensors.clear(), "header was changed"),
    ];
    for (name, change, expected) in lies {
        let mut parts = Parts::of(&bag);
        change(&mut parts);
        let (code, text) = verify(&service, &parts.write(&service.folder.path().join(format!("{name}.mcap"))));
        assert!(code == Some(4) && text.contains(expected), "{name}: {text}");
    }
    let held = forged("held", &|parts| parts.actions[4].held = true);
    let (code, text) = verify(&service, &held);
    assert!(code == Some(4) && text.contains("the action of step 5 is one of real time"), "{text}");
}

/// Guards many bags: servers share them, one that takes no more leaves its bags to the others, and what was never finished
/// is named.
#[test]
fn servers_share_the_bags() {
    let (service, _router) = Service::start_behind_router("verify-share");
    let mut recorder = service.record();
    service.play(&["--policy", "random", "--task", "S01", "--seed", "3", "--episodes", "4", "--recorded"]);
    recorder.wait_for("-e3.mcap");
    let (key, router) = (service.recorder_key().display().to_string(), endpoint(service.port));
    let args = ["--name", "other", "--capacity", "1", "-e", &router, "--recorder-key", &key];
    let mut other = Running::start("sim-server", &args, &service.folder);
    other.wait_for("connected to tcp/127.0.0.1:");
    let bags = service.bags();
    let (code, text) = verify_with(&service, &bags, &["--server", "test,other", "--parallel", "3"]);
    assert!(code == Some(0) && text.contains("4 of 4 bags are verified"), "{text}");

    // Of three at a time the server refuses two, and plays all the same.
    let (code, text) = verify_with(&service, &bags, &["--server", "other", "--parallel", "3"]);
    assert!(code == Some(0) && text.contains("4 of 4 bags are verified"), "{text}");

    let (code, text) = verify_with(&service, &bags, &["--server", "test,none"]);
    assert!(code == Some(1) && text.contains("none"), "{text}");
    let part = bags.join("a.mcap.part");
    std::fs::write(&part, []).unwrap();
    let (code, text) = verify_with(&service, &bags, &["--server", "test"]);
    assert!(code == Some(4) && text.contains("4 of 5 bags are verified") && text.contains("a.mcap.part: "), "{text}");
    let (code, text) = verify_with(&service, &part, &["--server", "test"]);
    assert!(code == Some(1) && text.contains("a.mcap.part: its recording was never finished"), "{text}");
}

/// Guards verification on every kind of server: one that records itself, one whose recorder follows all sessions, and one whose
/// recorder is away. A replay's records come to whoever opened it, and no bag is made of it.
#[test]
fn whoever_records_a_second_run_is_compared() {
    let idle = Service::start("verify-idle", &[]);
    let mut recorder = idle.record();
    idle.play(&["--policy", "random", "--task", "S01", "--seed", "3", "--recorded"]);
    recorder.wait_for(".mcap");
    let bag = idle.folder.files(".mcap").remove(0);
    let mut parts = Parts::of(&bag);
    parts.states[7].joint_effort[3] += 1e-12;
    parts.seal();
    let forged = parts.write(&bag.with_file_name("forged.mcap"));
    let bags = std::env::temp_dir().join(format!("fiatlux-verify-bags-{}", std::process::id()));
    let itself = Service::start("verify-itself", &["--record", &bags.display().to_string()]);
    let compare = |service: &Service, what: &str| {
        let (code, text) = verify(service, &bag);
        assert!(code == Some(0) && text.starts_with("equal: "), "{what}: {text}");
        let (code, text) = verify(service, &forged);
        assert!(code == Some(4) && text.contains("row 7: joint_effort of "), "{what}: {text}");
    };
    compare(&itself, "records itself");
    compare(&idle, "a recorder follows");
    recorder.signal("TERM");
    assert!(recorder.finish(PATIENCE).0.success());
    compare(&idle, "the recorder is away");
    assert_eq!(idle.folder.files(".mcap").len(), 2, "no bag of a second run");
    assert!(!std::fs::read_dir(&bags).is_ok_and(|folders| {
        folders
            .flatten()
            .any(|entry| entry.path().is_dir() && std::fs::read_dir(entry.path()).is_ok_and(|f| f.count() > 0))
    }));
    drop(std::fs::remove_dir_all(&bags));
}
