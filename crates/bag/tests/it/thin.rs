//! Thin bags: what they keep, and rows that are simulated when they are read. The simulator of these tests makes up the same rows as
//! `common`, or says that they are others.

use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};

use fiatlux_bag::{Bag, BagError, BagWriter, Completeness, Patience, Simulated, Unsimulated, convert, simulate_with};
use fiatlux_proto::v3::EpisodeHeader;

use crate::common::{folder, header, push, result, state, write};

const ROWS: u64 = 300;
static RUNS: AtomicUsize = AtomicUsize::new(0);

fn simulate(bag: &Bag, into: &Path, _: Simulated) -> Result<(), Unsimulated> {
    RUNS.fetch_add(1, Ordering::Relaxed);
    if bag.header().policy == "liar" {
        return Err(Unsimulated::Differs("its actions make rows with the digest ff, its result says ab12".into()));
    }
    if bag.header().policy == "stranger" {
        return Err(Unsimulated::Unable("it is of another version".into()));
    }
    if bag.header().policy == "full" {
        return Err(Unsimulated::NoRoom("No space left on device".into()));
    }
    if !bag.goes_on() {
        return Err(Unsimulated::Differs("it takes longer than the limit".into()));
    }
    let mut writer = BagWriter::create(into, bag.header()).unwrap();
    push(&mut writer, 0..ROWS);
    writer.finish(bag.result().unwrap()).map(drop).map_err(|error| Unsimulated::Unable(error.to_string()))
}

#[test]
fn a_thin_bag_reads_like_the_full_one() {
    simulate_with(simulate);
    let folder = folder("thin");
    let path = write(&folder.join("a.mcap"), ROWS);
    let bytes = std::fs::read(&path).unwrap();
    let (small, again) = (folder.join("b.mcap"), folder.join("c.mcap"));
    let full = Bag::open(&path).unwrap();
    full.write_thin(&small).unwrap();
    full.write_thin(&again).unwrap();
    assert_eq!(std::fs::read(&small).unwrap(), std::fs::read(&again).unwrap(), "the same bag gives the same bytes");
    assert!(std::fs::read(&small).unwrap().len() * 2 < bytes.len());

    let thin = Bag::open(&small).unwrap();
    thin.check().unwrap();
    assert!(thin.is_thin() && !full.is_thin());
    assert_eq!((thin.header(), thin.result()), (full.header(), full.result()));
    assert_eq!(thin.completeness(), &Completeness::Whole);
    let before = RUNS.load(Ordering::Relaxed);
    assert_eq!(
        thin.actions().map(Result::unwrap).collect::<Vec<_>>(),
        full.actions().map(Result::unwrap).collect::<Vec<_>>()
    );
    assert_eq!(RUNS.load(Ordering::Relaxed), before, "actions are in the file");
    let shared = thin.clone();
    assert_eq!(thin.states().map(Result::unwrap).collect::<Vec<_>>(), (0..ROWS).map(state).collect::<Vec<_>>());
    assert_eq!(thin.events().count(), full.events().count());
    assert_eq!(shared.rewards().count() as u64, ROWS - 1);
    let mut states = shared.states();
    assert_eq!(states.by_ref().count() as u64, ROWS);
    shared.check_rest(&states.into_read()).unwrap();
    assert_eq!(shared.observations().count() as u64, ROWS);
    assert_eq!(shared.frames().count(), full.frames().count());

    // Both ways, in place; the second time nothing is left to do.
    assert!(convert(&path, true).unwrap() && !convert(&path, true).unwrap());
    assert_eq!(std::fs::read(&path).unwrap(), std::fs::read(&small).unwrap());
    assert!(convert(&path, false).unwrap() && !convert(&path, false).unwrap());
    assert!(std::fs::read(&path).unwrap() == bytes, "a bag that was thin is the one that was recorded");
    let names: Vec<_> = std::fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    assert_eq!(names.len(), 3, "{names:?}");
}

/// Guards that a bag is not called changed because this program cannot play it.
#[test]
fn a_bag_that_cannot_be_simulated_here_is_not_an_altered_one() {
    simulate_with(simulate);
    let path = folder("thin-stranger").join("a.mcap");
    let mut writer = BagWriter::create(&path, &EpisodeHeader { policy: "stranger".into(), ..header() }).unwrap();
    push(&mut writer, 0..ROWS);
    writer.finish(&result(ROWS)).unwrap();
    assert!(convert(&path, true).unwrap());
    let read: Vec<_> = Bag::open(&path).unwrap().states().collect();
    assert!(matches!(&read[..], [Err(BagError::Unable { reason, .. })] if reason.contains("version")), "{read:?}");
}

/// Guards a bag against a machine that is full: another try may succeed.
#[test]
fn a_machine_without_room_says_nothing_against_a_bag() {
    simulate_with(simulate);
    let path = folder("thin-full").join("a.mcap");
    let mut writer = BagWriter::create(&path, &EpisodeHeader { policy: "full".into(), ..header() }).unwrap();
    push(&mut writer, 0..ROWS);
    writer.finish(&result(ROWS)).unwrap();
    assert!(convert(&path, true).unwrap());
    let error = convert(&path, false).unwrap_err();
    assert!(error.is_of_machine() && error.to_string().contains("no room for the simulated rows"), "{error}");
    assert!(!Bag::open(path.with_file_name("none.mcap")).unwrap_err().is_of_machine());
}

/// Guards pictures that no program can make again.
#[test]
fn a_bag_whose_sensors_used_a_file_stays_full() {
    let path = folder("thin-meshes").join("a.mcap");
    let mut writer = BagWriter::create(&path, &EpisodeHeader { meshes: "ab".into(), ..header() }).unwrap();
    push(&mut writer, 0..ROWS);
    writer.finish(&result(ROWS)).unwrap();
    let before = std::fs::read(&path).unwrap();
    assert!(Bag::open(&path).unwrap().stays_full().is_some());
    assert!(matches!(convert(&path, true), Err(BagError::Form { .. })));
    assert!(std::fs::read(&path).unwrap() == before, "it stays as it is");
}

#[test]
fn rows_of_other_actions_are_refused_by_name() {
    simulate_with(simulate);
    let folder = folder("thin-liar");
    let path = folder.join("a.mcap");
    let mut writer = BagWriter::create(&path, &EpisodeHeader { policy: "liar".into(), ..header() }).unwrap();
    push(&mut writer, 0..ROWS);
    writer.finish(&result(ROWS)).unwrap();
    let says = "a.mcap cannot be simulated: its actions make rows with the digest ff";
    let error = Bag::open(&path).unwrap().check_actions().unwrap_err().to_string();
    assert!(error.contains(says), "{error}");
    assert!(convert(&path, true).unwrap());
    let thin = Bag::open(&path).unwrap();
    let read: Vec<_> = thin.states().collect();
    assert!(
        matches!(&read[..], [Err(error @ BagError::Simulated { .. })] if error.to_string().contains(says)),
        "{read:?}"
    );
    assert!(convert(&path, false).unwrap_err().to_string().contains(says));
    assert!(Bag::open(&path).unwrap().is_thin(), "it stays as it is");
    let slow = thin.clone().with_patience(Some(Patience::new(|| false)));
    assert!(matches!(slow.states().next(), Some(Err(BagError::Slow { .. }))));
}

#[test]
fn what_is_no_whole_episode_stays_full() {
    let folder = folder("thin-cut");
    let path = folder.join("a.mcap");
    let mut writer = BagWriter::create(&path, &header()).unwrap();
    push(&mut writer, 0..40);
    writer.finish_cut("its server was gone").unwrap();
    let bytes = std::fs::read(&path).unwrap();
    let error = convert(&path, true).unwrap_err().to_string();
    assert!(error.contains("a.mcap cannot be made thin: it is cut"), "{error}");
    assert_eq!(std::fs::read(&path).unwrap(), bytes);
    assert_eq!(std::fs::read_dir(&folder).unwrap().count(), 1);
}

/// Guards that readers cannot disagree about what counts: a thin bag with rows of its own is not a bag.
#[test]
fn rows_in_a_thin_bag_are_refused() {
    let folder = folder("thin-rows");
    let full = write(&folder.join("full.mcap"), ROWS);
    let thin = Bag::open(&full).unwrap().write_thin(&folder.join("thin.mcap")).unwrap();
    // The full bag's chunks, with the mark of a thin one: a metadata record before the first of them.
    let (bytes, marked) = (std::fs::read(&full).unwrap(), std::fs::read(&thin).unwrap());
    let start = |bytes: &[u8]| {
        let mut at = 8;
        let mut records = Vec::new();
        while records.len() < 3 {
            let length = u64::from_le_bytes(bytes[at + 1..at + 9].try_into().unwrap()) as usize + 9;
            records.push(at..at + length);
            at += length;
        }
        records
    };
    let mark = start(&marked)[2].clone();
    let at = start(&bytes)[1].end;
    let forged = [&bytes[..at], &marked[mark], &bytes[at..]].concat();
    let path = folder.join("forged.mcap");
    std::fs::write(&path, forged).unwrap();
    let error = Bag::open(&path).map(|bag| (bag.is_thin(), bag.completeness().clone())).unwrap_err().to_string();
    assert!(error.contains("it says that it is thin, and has more than actions and a result"), "{error}");
    assert!(Bag::open(&thin).unwrap().is_thin());
}
