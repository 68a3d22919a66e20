//! The ledger of a run, and journals that were cut, damaged or edited.

use std::fs;
use std::path::{Path, PathBuf};

use fiatlux_bag::run::{
    ABANDONED, EpisodeState, Event, Ledger, LedgerError, LedgerWriter, MAX_ATTEMPTS, Marks, NOT_RUN, PlannedEpisode,
    PlayedEpisode, Prefix, Registration, journals,
};
use fiatlux_proto::PROTOCOL;
use fiatlux_proto::v3::{OpenRequest, PropScale, RunSpec, Sensor};

fn registration() -> Registration {
    let scale = PropScale { socket: 0.1 + 0.2, ..PropScale::default() };
    let session = OpenRequest { robot: "g1_bare".into(), prop_scale: Some(scale), ..OpenRequest::default() };
    Registration {
        protocol: PROTOCOL,
        version: "1.2.3".into(),
        server: "lab".into(),
        run: "first".into(),
        key_sha256: "ab".repeat(32),
        spec: RunSpec { policy: "say \"yes\"\n".into(), session: Some(session), ..RunSpec::default() },
        episodes: ["S01", "S02", "S03"].map(|task| PlannedEpisode { task: task.into(), seed: (1 << 53) - 1 }).into(),
        unix_ms: 1,
        holder: String::new(),
        group: Vec::new(),
    }
}

/// A hosted run of a group.
fn shared(group: &[&str]) -> Registration {
    let spec = RunSpec { hosted_seeds: 3, ..RunSpec::default() };
    Registration { spec, group: group.iter().map(|name| (*name).to_owned()).collect(), ..registration() }
}

/// Guards an episode of a group against a second play: a journal in which another server begins it is no journal.
#[test]
fn an_episode_of_a_group_has_one_server() {
    let mut ledger = Ledger::new(shared(&["lab", "lab-2"])).expect("a ledger");
    ledger.apply(&opened(0, 1)).expect("its own");
    let refused = ledger.apply(&opened(1, 1)).expect_err("lab-2's");
    assert!(refused.contains("episode 1 belongs to server lab-2, and lab began it"), "{refused}");
    ledger.apply(&opened(2, 1)).expect("its own");
    assert_eq!(ledger.registration().owner(3), Some("lab-2"));
    assert_eq!(Ledger::new(registration()).expect("a ledger").registration().owner(1), None);
}

fn folder(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("ledger").join(name);
    let _ = fs::remove_dir_all(&folder);
    folder
}

fn opened(episode: u32, attempt: u32) -> Event {
    Event::Opened { episode, attempt, session: format!("s-{episode}-{attempt}"), unix_ms: 2 }
}

fn played(episode: u32, attempt: u32) -> Event {
    Event::Played {
        episode,
        attempt,
        session: format!("s-{episode}-{attempt}"),
        bag: "S01-e0-a1.mcap".into(),
        digest: "cd".repeat(32),
        cause: "success".into(),
        success: true,
        steps: 70,
    }
}

fn marks(steps: u64) -> Marks {
    let mut marks = Marks::default();
    (0..=steps).for_each(|step| marks.push(step, &[step as u8; 32]));
    marks
}

fn abandoned(episode: u32, attempt: u32, steps: u64, digest: &str) -> Event {
    let (session, cause) = (format!("s-{episode}-{attempt}"), "the client is gone".into());
    Event::Abandoned { episode, attempt, session, steps, digest: digest.repeat(32), marks: marks(steps), cause }
}

/// Writes the journal of a run in which everything happened.
fn write(folder: &Path) -> (PathBuf, Ledger) {
    let mut writer = LedgerWriter::create(folder, registration()).expect("a journal");
    let events = [opened(0, 1), abandoned(0, 1, 9, "0a"), opened(1, 1), opened(0, 2), Event::Restarted { unix_ms: 3 }];
    let more = [opened(0, 3), abandoned(0, 3, 5, "0b"), opened(0, 4), played(0, 4), Event::Finished { unix_ms: 4 }];
    for event in events.into_iter().chain(more) {
        writer.append(event).expect("it follows");
    }
    (writer.path().to_owned(), writer.ledger().clone())
}

#[test]
fn a_journal_tells_what_became_of_each_episode() {
    let folder = folder("tells");
    let (path, written) = write(&folder);
    assert_eq!(
        (path.file_name().and_then(|name| name.to_str()), journals(&folder).expect("a list")),
        (Some("lab.run.jsonl"), vec![path.clone()])
    );
    let ledger = Ledger::read(&path).expect("a ledger");
    assert_eq!(ledger, written);
    assert_eq!(ledger.registration(), &registration());
    assert!(ledger.is_finished() && !ledger.is_hosted() && ledger.open().next().is_none());
    let [first, second, third] = ledger.episodes() else { panic!("three episodes") };
    assert!(
        matches!(&first.state, EpisodeState::Played(PlayedEpisode { success: true, steps: 70, bag, .. }) if bag == "S01-e0-a1.mcap")
    );
    // The longest abandoned attempt binds; the one that the server's death ended does not.
    assert_eq!(first.prefix, Some(Prefix { steps: 9, digest: "0a".repeat(32), marks: marks(9) }));
    assert_eq!((first.attempts, first.lost, first.abandoned.as_str()), (4, 1, "the client is gone"));
    assert_eq!((&second.state, second.lost), (&EpisodeState::Failed { cause: NOT_RUN.into() }, 1));
    assert_eq!((&third.state, third.attempts), (&EpisodeState::Failed { cause: NOT_RUN.into() }, 0));
}

#[test]
fn what_does_not_follow_is_refused_and_changes_nothing() {
    let writer = |name: &str| LedgerWriter::create(&folder(name), registration()).expect("a journal");
    let mut writer = writer("follows");
    writer.append(opened(0, 1)).expect("it follows");
    let other = Event::Played {
        episode: 0,
        attempt: 1,
        session: "other".into(),
        bag: "a.mcap".into(),
        digest: "cd".repeat(32),
        cause: String::new(),
        success: true,
        steps: 1,
    };
    let with = |bag: &str, digest: &str| Event::Played {
        episode: 0,
        attempt: 1,
        session: "s-0-1".into(),
        bag: bag.into(),
        digest: digest.into(),
        cause: String::new(),
        success: true,
        steps: 1,
    };
    let wrong = [
        opened(0, 2),
        opened(1, 2),
        opened(3, 1),
        opened(u32::MAX, 1),
        played(0, 2),
        played(1, 1),
        other,
        with("../a.mcap", &"cd".repeat(32)),
        with(".a.mcap", &"cd".repeat(32)),
        with("a.mcap", "cd"),
        Event::Opened { episode: 1, attempt: 1, session: "s".repeat(600), unix_ms: 0 },
        Event::Finished { unix_ms: 5 },
    ];
    let (before, bytes) = (writer.ledger().clone(), fs::read(writer.path()).expect("a file"));
    for event in wrong {
        assert!(matches!(writer.append(event.clone()), Err(LedgerError::Event { .. })), "{event:?}");
    }
    assert_eq!((writer.ledger(), fs::read(writer.path()).expect("a file")), (&before, bytes));
    let again = LedgerWriter::create(writer.path().parent().expect("a folder"), registration());
    assert!(matches!(again, Err(LedgerError::Exists { .. })));
    let sensor = Sensor { rate_hz: f64::INFINITY, ..Sensor::default() };
    let session = OpenRequest { sensors: vec![sensor], ..OpenRequest::default() };
    let infinite = RunSpec { session: Some(session), ..RunSpec::default() };
    for wrong in [
        Registration { episodes: Vec::new(), ..registration() },
        Registration { episodes: vec![registration().episodes[0].clone(); 2], ..registration() },
        Registration { run: "../a".into(), ..registration() },
        Registration { key_sha256: "secret".into(), ..registration() },
        Registration { spec: infinite, ..registration() },
        shared(&["lab-2", "lab-3"]),
        shared(&["lab", "lab"]),
        shared(&["lab-2", "lab"]),
        Registration { spec: RunSpec::default(), ..shared(&["lab", "lab-2"]) },
    ] {
        assert!(LedgerWriter::create(&folder("wrong"), wrong).is_err());
    }
}

#[test]
fn attempts_have_an_end() {
    let mut ledger = Ledger::new(registration()).expect("a ledger");
    for attempt in 1..=MAX_ATTEMPTS {
        ledger.apply(&opened(0, attempt)).expect("it follows");
        ledger.apply(&abandoned(0, attempt, 3, "0a")).expect("it follows");
    }
    assert_eq!(ledger.episodes()[0].state, EpisodeState::Failed { cause: ABANDONED.into() });
}

/// Guards that a partial last line is ignored, and that the journal continues after the line before it.
#[test]
fn a_torn_line_is_left_out() {
    let folder = folder("torn");
    let (path, _) = write(&folder);
    let whole = fs::read(&path).expect("a file");
    let last = whole[..whole.len() - 1].iter().rposition(|byte| *byte == b'\n').expect("lines") + 1;
    for end in [last, last + 1, last + 30, whole.len() - 1] {
        fs::write(&path, &whole[..end]).expect("a file");
        assert!(!Ledger::read(&path).expect("a ledger").is_finished());
        let mut writer = LedgerWriter::open(&path).expect("a journal");
        writer.append(Event::Finished { unix_ms: 4 }).expect("it follows");
        assert_eq!(fs::read(&path).expect("a file"), whole);
    }
    // After a crash, a block that was never written reads as zeros.
    fs::write(&path, [&whole[..last], &[0; 100]].concat()).expect("a file");
    assert!(!Ledger::read(&path).expect("a ledger").is_finished());
}

#[test]
fn a_line_that_was_touched_is_named() {
    let folder = folder("touched");
    let (path, written) = write(&folder);
    let whole = fs::read(&path).expect("a file");
    for at in (0..whole.len()).step_by(7) {
        for change in [1, 0x80] {
            let mut bytes = whole.clone();
            bytes[at] ^= change;
            fs::write(&path, &bytes).expect("a file");
            match Ledger::read(&path) {
                Err(LedgerError::Line { line, .. }) => {
                    let before = bytes[..at].iter().filter(|byte| **byte == b'\n').count();
                    assert!(line == before + 1, "byte {at}: line {line}");
                }
                // The last line break is gone: its line is torn.
                Ok(ledger) => assert!(at == whole.len() - 1 && ledger != written, "byte {at}"),
                Err(error) => panic!("byte {at}: {error}"),
            }
        }
    }
    let mut lines: Vec<&[u8]> = whole.split_inclusive(|byte| *byte == b'\n').collect();
    lines.remove(3);
    fs::write(&path, lines.concat()).expect("a file");
    let error = Ledger::read(&path).expect_err("a line is missing").to_string();
    assert!(error.contains("lab.run.jsonl, line 4: ") && error.contains("chain"), "{error}");
}

#[test]
fn garbage_is_refused() {
    let folder = folder("garbage");
    fs::create_dir_all(&folder).expect("a folder");
    let path = folder.join("lab.run.jsonl");
    let mut state = 1_u64;
    let mut cases = vec![Vec::new(), b"\n".to_vec(), b"{}\n".to_vec(), vec![b'\n'; 1000], vec![b'['; 5 << 20]];
    for length in 0..300 {
        let bytes = (0..length).map(|_| {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (state >> 56) as u8
        });
        cases.push(bytes.chain(*b"\n").collect());
    }
    for bytes in cases {
        fs::write(&path, &bytes).expect("a file");
        assert!(matches!(Ledger::read(&path), Err(LedgerError::Line { line: 1, .. })));
    }
    assert!(matches!(Ledger::read(folder.join("none")), Err(LedgerError::Io { .. })));
}

/// Guards that a journal is not left half made on a full disk.
#[test]
fn a_journal_that_cannot_be_made_says_so() {
    let folder = folder("full");
    fs::create_dir_all(folder.parent().expect("a parent")).expect("a folder");
    fs::write(&folder, "a file in place of the folder").expect("a file");
    let error = LedgerWriter::create(&folder, registration()).expect_err("no folder").to_string();
    assert!(error.contains("space"), "{error}");
    let _ = fs::remove_file(&folder);
}

/// Guards that a signature covers the whole journal of a finished run, once, and no other lines.
#[test]
fn a_journal_is_sealed_at_its_end() {
    let folder = folder("sealed");
    let sign = |link: &str| ("ed25519:key".to_owned(), format!("of {link}"));
    let mut writer = LedgerWriter::create(&folder, registration()).expect("a journal");
    writer.append(opened(0, 1)).expect("it follows");
    assert!(writer.seal(sign).is_err(), "the run goes on");
    writer.append(played(0, 1)).expect("it follows");
    writer.append(Event::Finished { unix_ms: 4 }).expect("it follows");
    writer.seal(sign).expect("it is finished");
    let path = writer.path().to_owned();
    let whole = fs::read_to_string(&path).expect("a file");
    // Once more changes nothing, also after a restart.
    LedgerWriter::open(&path).expect("a journal").seal(sign).expect("it is sealed");
    assert_eq!(fs::read_to_string(&path).expect("a file"), whole);
    let ledger = Ledger::read(&path).expect("a ledger");
    let seal = ledger.seal().expect("a seal");
    let above = whole.lines().rev().nth(1).expect("the line before");
    assert!(seal.of.len() == 64 && above.contains(&seal.of), "{above}");
    assert_eq!((seal.key.as_str(), seal.signature.clone()), ("ed25519:key", format!("of {}", seal.of)));
    // With a chain that holds, but of other lines.
    fs::remove_file(&path).expect("removed");
    let mut forged = LedgerWriter::create(&folder, registration()).expect("a journal");
    forged.append(Event::Finished { unix_ms: 4 }).expect("it follows");
    let (of, key, signature) = (seal.of.clone(), seal.key.clone(), seal.signature.clone());
    forged.append(Event::Sealed { of, key, signature }).expect("a line");
    let error = Ledger::read(&path).expect_err("another journal's").to_string();
    assert!(error.contains("line 3: ") && error.contains("does not cover the lines above"), "{error}");
}
