//! Thin bags: the same results, verdicts and bytes as full ones, and no room for a forger.

use std::path::Path;
use std::process::Command;

use fiatlux_access::Identity;
use fiatlux_bag::{Bag, convert};
use fiatlux_tests::forge::Parts;
use fiatlux_tests::programs::{Scratch, Service, endpoint, program};

/// Exit code of a program, and all that it says, on one line.
fn run(name: &str, args: &[&str], folder: &Path) -> (Option<i32>, String) {
    let done = Command::new(program(name)).args(args).current_dir(folder).output().unwrap();
    let said = [&done.stdout, &done.stderr].map(|bytes| String::from_utf8_lossy(bytes)).concat();
    (done.status.code(), said.split_whitespace().collect::<Vec<_>>().join(" "))
}

/// Guards both ways through every command: recorded thin, made thin, filled, graded, resumed, shown.
#[test]
fn thin_bags_give_what_full_ones_give() {
    let scratch = Scratch::new("thin");
    let folder = scratch.path();
    // Actions, joint targets, whole-body commands.
    for (policy, task) in [("random", "S05"), ("walk", "S05"), ("expert", "S06")] {
        let options = ["evaluate", "--policy", policy, "--tasks", task, "--seeds", "1"];
        let play = |out: &str, more: &[&str]| {
            let (code, said) = run("fiatlux", &[&options[..], &["--out", out], more].concat(), folder);
            assert_eq!(code, Some(0), "{said}");
            assert_eq!(said.contains("no replays and stills: thin bags"), out == "thin", "{said}");
        };
        play("full", &[]);
        play("thin", &["--bags", "thin"]);
        let bag = format!("bags/{task}-s1-e0.mcap");
        let paths = [format!("full/{bag}"), format!("thin/{bag}")];
        let [full, thin] = paths.each_ref().map(String::as_str);
        assert!(Bag::open(folder.join(thin)).unwrap().is_thin());
        let read = |name: &str| std::fs::read(folder.join(name)).unwrap();
        assert!(
            read("full/results.json") == read("thin/results.json"),
            "{policy}: a thin evaluation has other results"
        );
        let recorded = read(full);
        // A second call plays nothing, and keeps them.
        play("thin", &["--bags", "thin"]);
        let (code, said) = run("scorer", &["grade", "thin"], folder);
        assert!(code == Some(0) && said.contains("says the same as its bags"), "{said}");
        let (code, said) = run("fiatlux", &["view", thin, "--out", "page.html", "--force"], folder);
        assert!(code == Some(0) && folder.join("page.html").metadata().unwrap().len() > 100_000, "{said}");

        let (code, said) = run("scorer", &["thin", "full"], folder);
        assert!(code == Some(0) && said.contains("1 of 1 bag made thin"), "{said}");
        let (code, said) = run("scorer", &["fill", "thin"], folder);
        assert!(code == Some(0) && said.contains("1 of 1 bag made full"), "{said}");
        let (code, said) = run("scorer", &["fill", "full"], folder);
        assert_eq!(code, Some(0), "{said}");
        assert!(read(full) == recorded, "{policy}: a filled bag is not the recorded one");
        for out in ["full", "thin"] {
            std::fs::remove_dir_all(folder.join(out)).unwrap();
        }
    }
}

/// Guards the signature of a hosted bag in both forms, and that nothing in a thin bag can be changed: whatever a forger does to actions,
/// result or header, verify, grade and fill find it and say what differs.
#[test]
fn nothing_in_a_thin_bag_can_be_changed() {
    let keys = Scratch::new("thin-keys");
    let identity = Identity::generate().unwrap();
    let (own, known) = (keys.path().join("server.key"), keys.path().join("servers"));
    identity.write(&own).unwrap();
    std::fs::write(&known, format!("test {}\n", identity.public())).unwrap();
    let service = Service::start("thin-forged", &["--identity", own.to_str().unwrap()]);
    let mut recorder = service.record();
    service.play(&["--policy", "random", "--task", "S05", "--seed", "3", "--recorded"]);
    recorder.wait_for(".mcap");
    let (folder, recorded) = (service.folder.path(), service.folder.files(".mcap").remove(0));
    let place = endpoint(service.port);
    let verify = |bag: &Path, more: &[&str]| {
        run("scorer", &[&["verify", bag.to_str().unwrap(), "-e", &place], more].concat(), folder)
    };
    let signers = ["--signers", known.to_str().unwrap()];
    let full = verify(&recorded, &signers);
    let thin = folder.join("signed.mcap");
    std::fs::copy(&recorded, &thin).unwrap();
    assert!(convert(&thin, true).unwrap());
    assert_eq!(verify(&thin, &signers), full, "both forms have one verdict and one signature");
    assert!(full.0 == Some(0) && full.1.starts_with("equal: "), "{}", full.1);

    type Change = fn(&mut Parts);
    // Where every digest is made anew, the rows are the recorded ones: those of other actions.
    let cases: [(&str, Change, bool, &str); 6] = [
        ("action", |parts| parts.actions[5].action.as_mut().unwrap().action[3] += 1e-9, false, "result: end.digest is"),
        ("short", |parts| drop(parts.actions.pop()), false, "the result claims"),
        ("long", |parts| parts.actions.push(parts.actions[0].clone()), false, "the result claims"),
        ("digest", |parts| parts.result.end.as_mut().unwrap().digest = "ab".repeat(32), false, "result: end.digest is"),
        ("result", |parts| parts.result.total_reward += 1.0, false, "result: total_reward is"),
        (
            "seed",
            |parts| {
                parts.header.seed += 1;
                parts.header.request.as_mut().unwrap().seed += 1;
            },
            true,
            "header: ",
        ),
    ];
    for (name, change, is_sealed, says) in cases {
        let mut parts = Parts::of(&recorded);
        change(&mut parts);
        parts.result.signature = None;
        if is_sealed {
            parts.seal();
        }
        let path = folder.join(format!("forged-{name}.mcap"));
        // A bag with one action too many has a row for it.
        if name == "long" {
            parts.states.push(fiatlux_proto::v3::State { step: parts.states.len() as u64, ..parts.states[0].clone() });
        }
        parts.write(&path);
        assert!(convert(&path, true).unwrap(), "{name}");
        let (code, said) = verify(&path, &[]);
        assert!(code == Some(4) && said.contains(says), "{name}: {code:?}: {said}");
        let (code, said) = run("scorer", &["grade", path.to_str().unwrap()], folder);
        assert!(code != Some(0) && said.contains("cannot be simulated"), "{name}: {code:?}: {said}");
        let before = std::fs::read(&path).unwrap();
        let (code, said) = run("scorer", &["fill", path.to_str().unwrap()], folder);
        assert!(code == Some(3) && said.contains(&format!("forged-{name}.mcap")), "{name}: {said}");
        assert!(std::fs::read(&path).unwrap() == before, "{name}: it stays as it is");
    }
}
