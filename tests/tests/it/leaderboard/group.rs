//! A hosted run over servers that have their own folders.

use std::path::PathBuf;
use std::process::Command;

use fiatlux_access::{Identity, KnownServers, RecorderKey};
use fiatlux_bag::run::{Event, journals};
use fiatlux_tests::forge::JournalParts;
use fiatlux_tests::programs::{PATIENCE, Running, endpoint, program};

use super::lab::{Board, Lab};

const NAMES: [&str; 3] = ["lab", "lab-2", "lab-3"];

/// Number of hosted rooms, each with 12 episodes.
fn rooms() -> usize {
    if std::env::var_os("FIATLUX_SLOW_TESTS").is_some() { 8 } else { 1 }
}

/// Guards that a group's servers play one hosted run without a common folder: each a third of its episodes, none twice; that it gets its
/// badge; and that a journal with another server's episode is refused.
#[test]
fn a_hosted_run_spreads_over_servers_without_a_common_folder() {
    let lab = Lab::start("board-spread");
    let folder = lab.folder().path().to_owned();
    let at = |name: &str| folder.join(name).display().to_string();
    RecorderKey::generate().unwrap().write(&folder.join("seeds")).unwrap();
    let link = endpoint(lab.port());
    let (mut servers, mut known) = (Vec::new(), String::new());
    for name in NAMES {
        let identity = Identity::generate().unwrap();
        identity.write(&folder.join(format!("{name}-identity"))).unwrap();
        known += &KnownServers::line(name, &identity.public());
        let [record, identity, key] =
            [format!("{name}-bags"), format!("{name}-identity"), "seeds".into()].map(|file| at(&file));
        // In any order.
        let group = ["--seed-key", &key, "--seed-group", "lab-3,lab,lab-2"];
        let own = ["--name", name, "-e", &link, "--record", &record, "--identity", &identity, "--bags", "thin"];
        let mut server = Running::start("sim-server", &[&own[..], &group[..]].concat(), lab.folder());
        server.wait_for(&format!("as {name}"));
        servers.push(server);
    }
    std::fs::write(folder.join("known"), known).unwrap();
    let file = at("spread.toml");
    let seeds = rooms().to_string();
    let evaluate = [
        "evaluate",
        "--policy",
        "random",
        "-e",
        &link,
        "--server",
        "lab",
        "--run-file",
        &file,
        "--shared-seeds",
        "--hosted",
        &seeds,
        "--json",
    ];
    let mut client = Running::start("policy-client", &evaluate, lab.folder());
    let (status, text) = client.finish(PATIENCE);
    assert!(status.success(), "{text}\n{}", client.log());
    let text = std::fs::read_to_string(&file).unwrap();
    let run = text.lines().find_map(|line| line.strip_prefix("run = \"")?.strip_suffix('"')).unwrap();
    let folders = NAMES.map(|name| folder.join(format!("{name}-bags")).join(run));
    let bags = |folder: &PathBuf| {
        std::fs::read_dir(folder)
            .unwrap()
            .filter(|file| file.as_ref().unwrap().path().extension().is_some_and(|end| end == "mcap"))
            .count()
    };
    assert_eq!(folders.each_ref().map(bags), [12 * rooms() / 3; 3]);

    let merge = |out: &str| {
        let out = folder.join(out);
        let done = Command::new(program("scorer")).arg("merge").arg(&out).args(&folders).output().unwrap();
        (
            done.status.code(),
            format!("{}{}", String::from_utf8_lossy(&done.stdout), String::from_utf8_lossy(&done.stderr)),
        )
    };
    let (code, said) = merge("merged");
    assert_eq!(code, Some(0), "{said}");
    let board = Board::start(&lab, &["--signers", &at("known"), "--server", "test"]);
    let (code, entry) = board.submit(&folder.join("merged"), &["--bags", "thin"]);
    assert_eq!(
        (code, entry["badge"].as_str(), entry["state"].as_str()),
        (0, Some("hosted"), Some("verified")),
        "{entry}"
    );
    assert_eq!(entry["episodes_to_verify"], 12 * rooms(), "{entry}");

    // A server with a list of its own, which began an episode of lab-2.
    let journal = journals(&folders[0]).unwrap().remove(0);
    let mut parts = JournalParts::of(&journal);
    std::fs::remove_file(&journal).unwrap();
    parts.registration.group = vec!["lab".into()];
    let opened = Event::Opened { episode: 1, attempt: 1, session: "a".into(), unix_ms: parts.registration.unix_ms };
    let closed = Event::Failed { episode: 1, attempt: 1, cause: "fall".into() };
    parts.events.splice(0..0, [opened, closed]);
    parts.write(&folders[0], None);
    let (code, said) = merge("twice");
    assert!(code == Some(1) && said.contains("the group of servers differs"), "{code:?}: {said}");
}
