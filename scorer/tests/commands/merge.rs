//! Shards as one folder.

use std::path::{Path, PathBuf};

use fiatlux_bag::run::{Event, LedgerWriter, PlannedEpisode, Registration};
use fiatlux_client::ShardRecord;
use fiatlux_proto::PROTOCOL;
use fiatlux_proto::v3::{EpisodeHeader, OpenRequest, RunSpec, RunTicket};
use fiatlux_rules::Task;

use crate::common::{Folder, Story, begin, header, result, rows, sealed};
use crate::scorer;

const SEEDS: u64 = 6;
const SHARDS: u64 = 3;

fn record(part: u64) -> ShardRecord {
    ShardRecord {
        shard: format!("{part}/{SHARDS}"),
        tasks: vec!["S01".into()],
        seeds: (0..SEEDS).collect(),
        again: "fiatlux evaluate --policy zero --tasks S01 --seeds 0..5 --shard {shard} --out {out}".into(),
    }
}

/// A room where the robot falls at this step.
fn bag(folder: &Path, seed: u64, step: u64, change: impl Fn(&mut EpisodeHeader)) -> PathBuf {
    std::fs::create_dir_all(folder.join("bags")).unwrap();
    let mut header = header(Task::S01, seed);
    change(&mut header);
    let (header, rows) = (sealed(header), rows(Task::S01, seed, Story::Falls(step)));
    let path = folder.join(format!("bags/S01-s{seed}-e0.mcap"));
    let _ = std::fs::remove_file(&path);
    begin(&path, &header, &rows).finish(&result(&header, &rows)).unwrap();
    path
}

/// A folder with the whole evaluation and its results, and the folders of its shards.
struct Evaluation {
    folder: Folder,
    shards: Vec<PathBuf>,
    results: Vec<u8>,
}

impl Evaluation {
    fn new(name: &str) -> Self {
        let folder = Folder::new(name);
        let whole = folder.0.join("whole");
        let shards: Vec<PathBuf> = (1..=SHARDS).map(|part| folder.0.join(format!("zero-{part}of{SHARDS}"))).collect();
        for seed in 0..SEEDS {
            bag(&whole, seed, 20 + seed, |_| ());
            bag(&shards[(seed % SHARDS) as usize], seed, 20 + seed, |_| ());
        }
        (1..=SHARDS).zip(&shards).for_each(|(part, shard)| record(part).keep(shard).unwrap());
        let claim = whole.join("results.json");
        assert_eq!(scorer(&["grade", whole.to_str().unwrap(), "--json", "--out", claim.to_str().unwrap()]).0, 0);
        let results = std::fs::read(claim).unwrap();
        Self { folder, shards, results }
    }

    fn out(&self) -> PathBuf {
        self.folder.0.join("out")
    }

    fn merge(&self, shards: &[&Path]) -> (i32, String) {
        let out = self.out();
        let paths = [out.as_path()].into_iter().chain(shards.iter().copied());
        let args: Vec<&str> = ["merge"].into_iter().chain(paths.map(|path| path.to_str().unwrap())).collect();
        let (code, _, err) = scorer(&args);
        (code, err.split_whitespace().collect::<Vec<_>>().join(" "))
    }

    fn all(&self) -> Vec<&Path> {
        self.shards.iter().map(PathBuf::as_path).collect()
    }
}

/// Guards the point of shards: the same results, byte for byte, whatever the order, and again.
#[test]
fn shards_are_the_evaluation_of_one_process() {
    let evaluation = Evaluation::new("merge-whole");
    let mut all = evaluation.all();
    for _ in 0..2 {
        let (code, said) = evaluation.merge(&all);
        assert!(code == 0 && said.contains("6 episodes of 3 folders"), "{code}: {said}");
        assert_eq!(std::fs::read(evaluation.out().join("results.json")).unwrap(), evaluation.results);
        all.reverse();
    }
    let out = evaluation.out();
    let (code, _, said) = scorer(&["grade", out.to_str().unwrap()]);
    assert!(code == 0 && said.contains("says the same as its bags"), "{said}");
    // A room that is there twice with the same rows counts once.
    bag(&evaluation.shards[1], 0, 20, |_| ());
    assert_eq!(evaluation.merge(&evaluation.all()).0, 0);
    assert_eq!(std::fs::read(out.join("results.json")).unwrap(), evaluation.results);
    // No file of anybody else's goes away.
    std::fs::remove_file(out.join("merged.json")).unwrap();
    let (code, said) = evaluation.merge(&evaluation.all());
    assert!(code == 1 && said.contains("has other files"), "{said}");
    let inside = [evaluation.folder.0.as_path()];
    assert!(evaluation.merge(&inside).1.contains("are in each other"));
}

/// Guards what others have in OUT, and what a list of an earlier merge says that is none.
#[test]
fn a_merge_removes_nothing_but_its_own_files() {
    let evaluation = Evaluation::new("merge-own");
    let (folder, out) = (&evaluation.folder.0, evaluation.out());
    assert_eq!(evaluation.merge(&evaluation.all()).0, 0);
    let played = bag(&out, 9, 20, |_| ());
    let (code, said) = evaluation.merge(&evaluation.all());
    assert!(code == 1 && said.contains("S01-s9-e0.mcap is not of an earlier merge"), "{said}");
    assert!(played.is_file() && out.join("bags/S01-s0-e0.mcap").is_file());
    std::fs::remove_file(played).unwrap();
    let stranger = folder.join("stranger");
    std::fs::write(&stranger, "x").unwrap();
    let names = format!("[\"../stranger\", {:?}]", stranger.display().to_string());
    let listed = std::fs::read_to_string(out.join("merged.json")).unwrap();
    std::fs::write(out.join("merged.json"), listed.replace('[', &names.replace(']', ", "))).unwrap();
    assert_eq!(evaluation.merge(&evaluation.all()).0, 0);
    assert!(stranger.is_file());
    let lock = fiatlux_bag::lock_folder(&out, "evaluate.lock").unwrap();
    let (code, said) = evaluation.merge(&evaluation.all());
    assert!(code == 1 && said.contains("is at work in"), "{said}");
    drop(lock);
    // Each of these rooms would be looked for.
    let all = ShardRecord { tasks: vec!["S01".into(); 2000], seeds: vec![1; 2000], ..record(1) };
    std::fs::remove_file(evaluation.shards[0].join("shard.json")).unwrap();
    all.keep(&evaluation.shards[0]).unwrap();
    let (code, said) = evaluation.merge(&evaluation.all());
    assert!(code == 1 && said.contains("more than 1000000 episodes"), "{said}");
}

#[test]
fn what_is_missing_is_named_with_the_command_that_plays_it() {
    let evaluation = Evaluation::new("merge-missing");
    let [one, two, three] = &evaluation.shards[..] else { unreachable!() };
    std::fs::remove_file(two.join("bags/S01-s4-e0.mcap")).unwrap();
    let (code, said) = evaluation.merge(&[one, two]);
    assert_eq!(code, 3, "{said}");
    for part in ["missing: S01, seed 2: it was not played", "missing: S01, seed 4", "missing: S01, seed 5"] {
        assert!(said.contains(part), "{part}: {said}");
    }
    for (part, folder) in [("2/3", two), ("3/3", three)] {
        let folder = folder.display();
        let command = format!("--tasks S01 --seeds 0..5 --shard {part} --out {folder}");
        assert!(said.contains(&command), "{command}: {said}");
    }
    assert!(!said.contains("--shard 1/3"), "{said}");
    // An altered bag is as if it were not there, and is named.
    bag(two, 4, 24, |_| ());
    let altered = bag(three, 5, 25, |_| ());
    let bytes = std::fs::read(&altered).unwrap();
    std::fs::write(&altered, &bytes[..bytes.len() / 2]).unwrap();
    let (code, said) = evaluation.merge(&evaluation.all());
    assert!(code == 3 && said.contains("missing: S01, seed 5:") && said.contains("zero-3of3/bags/S01-s5"), "{said}");
    let (code, _, graded) = scorer(&["grade", evaluation.out().to_str().unwrap()]);
    assert!(code == 0 && graded.contains("says the same as its bags"), "{graded}");
    // Played again, it is whole.
    bag(three, 5, 25, |_| ());
    assert_eq!(evaluation.merge(&evaluation.all()).0, 0);
    assert_eq!(std::fs::read(evaluation.out().join("results.json")).unwrap(), evaluation.results);
}

#[test]
fn what_is_no_part_of_it_is_refused() {
    let evaluation = Evaluation::new("merge-refused");
    let three = &evaluation.shards[2];
    type Change = fn(&mut EpisodeHeader);
    let changes: [(u64, u64, Change, &str); 4] = [
        (0, 30, |_| (), "two different recordings of S01, seed 0"),
        (5, 25, |header| header.policy = "stand".into(), "policy"),
        (5, 25, |header| header.version = "0.2.0".into(), "different versions of the server: 0.1.0 and 0.2.0"),
        (5, 25, |header| header.gains = "sonic".into(), "gains"),
    ];
    for (seed, step, change, says) in changes {
        let path = bag(three, seed, step, change);
        let (code, said) = evaluation.merge(&evaluation.all());
        assert!(code == 1 && said.contains(says), "{says}: {code}: {said}");
        assert!(!evaluation.out().exists(), "{says}: nothing is written");
        std::fs::remove_file(path).unwrap();
    }
    bag(three, 5, 25, |_| ());
    std::fs::remove_file(three.join("shard.json")).unwrap();
    ShardRecord { seeds: vec![0], ..record(3) }.keep(three).unwrap();
    let (code, said) = evaluation.merge(&evaluation.all());
    assert!(code == 1 && said.contains("shards of different evaluations"), "{said}");
}

/// The folder of a server in a run, which played these rooms, each until this step, and closed the run there.
fn server(folder: &Path, name: &str, run: &str, played: &[(u32, u64)]) -> PathBuf {
    let session = OpenRequest { episode_protocol: "published".into(), ..OpenRequest::default() };
    let planned = |seed| PlannedEpisode { task: "S01".into(), seed };
    let registration = Registration {
        protocol: PROTOCOL,
        version: "0.1.0".into(),
        server: name.into(),
        run: run.into(),
        key_sha256: "ab".repeat(32),
        spec: RunSpec { policy: "zero".into(), session: Some(session), ..RunSpec::default() },
        episodes: (0..SEEDS).map(planned).collect(),
        unix_ms: 0,
        holder: String::new(),
        group: Vec::new(),
    };
    let folder = folder.join(name).join(run);
    let mut writer = LedgerWriter::create(&folder, registration).unwrap();
    let session = || format!("{name}-session");
    for &(episode, step) in played {
        let seed = u64::from(episode);
        let ticket = RunTicket { run: run.into(), episode, attempt: 1, ..RunTicket::default() };
        let header = sealed(EpisodeHeader { run: Some(ticket), ..header(Task::S01, seed) });
        let rows = rows(Task::S01, seed, Story::Falls(step));
        let result = result(&header, &rows);
        let bag = format!("{name}-S01-s{seed}-a1.mcap");
        begin(&folder.join(&bag), &header, &rows).finish(&result).unwrap();
        let end = result.end.unwrap();
        writer.append(Event::Opened { episode, attempt: 1, session: session(), unix_ms: 1 }).unwrap();
        let (digest, cause, steps) = (end.digest, end.cause, end.steps);
        writer
            .append(Event::Played {
                episode,
                attempt: 1,
                session: session(),
                bag,
                digest,
                cause,
                success: false,
                steps,
            })
            .unwrap();
    }
    writer.append(Event::Finished { unix_ms: 3 }).unwrap();
    folder
}

/// Guards a run that several servers recorded into folders of their own.
#[test]
fn folders_of_a_runs_servers_are_one() {
    let evaluation = Evaluation::new("merge-run");
    let folder = &evaluation.folder.0;
    let [first, second] = [("lab-1", [0, 2, 4]), ("lab-2", [1, 3, 5])]
        .map(|(name, rooms)| server(folder, name, "r", &rooms.map(|k| (k, 20))));
    let (code, said) = evaluation.merge(&[&first, &second]);
    assert!(code == 0 && said.contains("6 episodes of 2 folders"), "{code}: {said}");
    // Whoever goes on with one of them does not write into the other.
    let journal = "runs/r/lab-1.run.jsonl";
    let merged = std::fs::read(evaluation.out().join(journal)).unwrap();
    std::fs::write(evaluation.out().join(journal), "").unwrap();
    assert!(std::fs::read(first.join("lab-1.run.jsonl")).unwrap() == merged);
    assert_eq!(evaluation.merge(&[&first, &second]).0, 0);
    let (code, _, graded) = scorer(&["grade", evaluation.out().to_str().unwrap()]);
    assert!(code == 0 && graded.contains("says the same as its bags"), "{graded}");
    let (code, said) = evaluation.merge(&[&first]);
    assert!(code == 3 && said.contains("missing: S01, seed 1: not run"), "{code}: {said}");
    // Seed 0 again, with other rows; and with the same.
    let other = server(folder, "lab-3", "r", &[(0, 21)]);
    let (code, said) = evaluation.merge(&[&first, &second, &other]);
    assert!(code == 1 && said.contains("S01, seed 0 is in") && said.contains("different rows"), "{code}: {said}");
    let same = server(folder, "lab-4", "r", &[(0, 20)]);
    assert_eq!(evaluation.merge(&[&first, &second, &same]).0, 0);
    let stranger = server(folder, "lab-5", "q", &[(5, 20)]);
    let (code, said) = evaluation.merge(&[&first, &second, &stranger]);
    assert!(code == 1 && said.contains("are of different runs"), "{code}: {said}");
}
