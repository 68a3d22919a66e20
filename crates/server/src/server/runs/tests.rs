//! The runs of a server in memory and on disk.

use fiatlux_access::RecorderKey;

use super::*;

const KEY: &str = "ed25519:AAAA";

fn folder(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../target/tmp/runs").join(name);
    let _ = fs::remove_dir_all(&folder);
    folder
}

fn spec(seeds: &[u64]) -> RunSpec {
    RunSpec { policy: "zero".into(), tasks: vec!["S05".into()], seeds: seeds.to_vec(), ..RunSpec::default() }
}

fn few(folder: &Path) -> Runs {
    let (runs, lock) = Runs::open(folder, "lab", None).expect("runs");
    // The lock goes with its file, so that the folder can be opened again.
    drop(lock);
    Runs { most: 3, ..runs }
}

/// Guards a server against being full for ever: only unfinished runs have a place, and a finished one is known by name, key and
/// outcome, also after a restart.
#[test]
fn finished_runs_take_no_place() {
    let folder = folder("finished");
    let runs = few(&folder);
    for number in 0..10 {
        let run = runs.register(&format!("run-{number}"), KEY, spec(&[number]), "").expect("registered");
        run.finish(None).expect("finished");
    }
    let open = |number| runs.register(&format!("open-{number}"), KEY, spec(&[number]), "");
    let held: Vec<_> = (0..3).map(|number| open(number).expect("registered")).collect();
    let refusal = open(3).err().expect("it is full");
    assert!(refusal.code() == Code::Busy && refusal.message.contains("3 unfinished runs"), "{}", refusal.message);
    drop(held);

    let again = few(&folder);
    assert_eq!(lock(&again.runs).keys().collect::<Vec<_>>(), ["open-0", "open-1", "open-2"]);
    for runs in [&runs, &again] {
        let run = runs.find("run-7", KEY).expect("known");
        let info = run.info().expect("its state");
        assert!(info.finished && info.episodes.len() == 1 && info.episodes[0].cause == "not run");
        let other = runs.find("run-7", "ed25519:BBBB").err().expect("another key");
        assert_eq!((other.code(), other.field.as_str()), (Code::Value, "key"));
        let other = runs.register("run-7", KEY, spec(&[8]), "").err().expect("another spec");
        assert_eq!(other.field, "register.seeds");
        assert!(runs.find("run-77", KEY).is_err_and(|refusal| refusal.code() == Code::Unknown));
    }
    again.find("open-1", KEY).expect("known").finish(None).expect("finished");
    again.register("one-more", KEY, spec(&[1]), "").expect("there is a place");
    assert!(lock(&again.recent).len() <= MAX_RECENT);
}

/// Guards ranges of seeds: they are the same run as its seeds one by one, and no range can ask for more than a run has.
#[test]
fn ranges_of_seeds_are_their_seeds() {
    let runs = few(&folder("ranges"));
    let range = |first, last| fiatlux_proto::v3::SeedRange { first, last };
    let ranges = |seed_ranges| RunSpec { seed_ranges, ..spec(&[5]) };
    let run = runs.register("many", KEY, ranges(vec![range(1000, 10_998)]), "").expect("10,000 episodes");
    let info = run.info().expect("its state");
    let (spec_of, seeds) = (info.spec.expect("a spec"), info.episodes.iter().map(|episode| episode.seed));
    assert_eq!(seeds.collect::<Vec<_>>(), [&[5][..], &(1000..10_999).collect::<Vec<_>>()].concat());
    assert!(spec_of.seed_ranges.is_empty() && spec_of.seeds.len() == 10_000);
    assert!(Arc::ptr_eq(&run, &runs.register("many", KEY, spec_of, "").expect("the same run")));
    for wrong in [
        vec![range(1000, 10_999)],
        vec![range(7, 6)],
        vec![range(0, u64::MAX)],
        vec![range(u64::MAX, u64::MAX), range(0, 10_000)],
    ] {
        let refusal = runs.register("other", KEY, ranges(wrong), "").err().expect("refused");
        assert_eq!((refusal.code(), refusal.field.as_str()), (Code::Value, "register.seed_ranges"));
    }
    let refusal = runs.register("other", KEY, ranges(vec![range(4, 6)]), "").err().expect("5 is named twice");
    assert_eq!(refusal.field, "register.seeds");
}

/// Guards hosted seeds that servers with folders of their own share: all draw the same, each plays its own and no other's, and none shows
/// another's. A run that has only the name in common has other seeds.
#[test]
fn servers_of_a_group_share_their_seeds() {
    let group: Vec<String> = ["lab-1", "lab-2", "lab-3"].map(str::to_owned).into();
    let key = RecorderKey::generate().expect("a key");
    let of = |server: &str, key: &RecorderKey, group: &[String]| {
        let shared = SharedSeeds { key: key.clone(), group: group.to_vec() };
        let folder = folder(&format!("group-{server}-{}", group.len()));
        let (runs, lock) = Runs::open(&folder, server, Some(shared)).expect("runs");
        drop(lock);
        runs
    };
    let hosted = || RunSpec { hosted_seeds: 8, ..spec(&[]) };
    let planned = |run: &Arc<Run>| lock(&run.state).ledger().registration().episodes.clone();
    let servers: Vec<Runs> = group.iter().map(|server| of(server, &key, &group)).collect();
    let runs: Vec<Arc<Run>> =
        servers.iter().map(|server| server.register("shared", KEY, hosted(), "").expect("registered")).collect();
    let episodes = planned(&runs[0]);
    assert!(runs.iter().all(|run| planned(run) == episodes));
    assert!(episodes.iter().all(|episode| (1 << 32..1 << 53).contains(&episode.seed)));
    for (place, run) in runs.iter().enumerate() {
        for index in 0..8 {
            let is_own = index as usize % 3 == place;
            match run.plan(index) {
                Ok((plan, _)) => assert!(is_own && plan.ticket.is_some_and(|ticket| ticket.hosted), "{place} {index}"),
                Err(refusal) => {
                    let owner = format!("belongs to server '{}'", group[index as usize % 3]);
                    assert!(!is_own && refusal.message.contains(&owner), "{place} {index}: {}", refusal.message);
                }
            }
        }
        run.finish(None).expect("finished");
        let info = run.info().expect("its state");
        for (index, (shown, planned)) in info.episodes.iter().zip(&episodes).enumerate() {
            let expected = if index % 3 == place { (planned.seed, "lab") } else { (0, &*group[index % 3]) };
            assert_eq!((shown.seed, shown.server.starts_with(expected.1)), (expected.0, true), "{place} {index}");
            assert_eq!(shown.state() == StateMessage::Failed, index % 3 == place);
        }
    }
    let fresh = |server: &Runs, name, spec| planned(&server.register(name, KEY, spec, "").expect("registered"));
    let other_spec = RunSpec { policy_version: "2".into(), ..hosted() };
    let other_key = of("lab-1", &RecorderKey::generate().expect("a key"), &group[..1]);
    let other_group = of("lab-1", &key, &group[..2]);
    let others = [
        fresh(&servers[0], "other", hosted()),
        fresh(&servers[0], "another", other_spec),
        fresh(&other_key, "shared", hosted()),
        fresh(&other_group, "shared", hosted()),
    ];
    let all: std::collections::BTreeSet<_> = others.iter().chain([&episodes]).flatten().collect();
    assert_eq!(all.len(), 5 * 8);
    // Named seeds are not shared: every server may play all of them.
    let named = servers[0].register("named", KEY, spec(&[1, 2]), "").expect("registered");
    assert!(lock(&named.state).ledger().registration().group.is_empty() && named.plan(1).is_ok());
}
