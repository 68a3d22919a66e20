//! A recorder against a server of our own making, on a carrier without a network.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Mutex;
use std::time::Duration;

use fiatlux_access::RowsKey;
use fiatlux_bag::{Bag, Completeness, part_of};
use fiatlux_carrier::{Publisher, Quality};
use fiatlux_proto::keys::ServerKeys;
use fiatlux_proto::v3::{EpisodeEnd, Observation, State, StepRecord, StepRecordAck, StepRecordRequest};
use fiatlux_proto::{Message, PROTOCOL};

use super::*;

const SECONDS: u64 = 20;

/// A session whose truths were made in advance.
struct FakeSession {
    /// By number; those below the acknowledged one are gone.
    kept: Arc<Mutex<BTreeMap<u64, StepRecord>>>,
    acked: Arc<Mutex<u64>>,
    /// Why the recorder cannot write, as it said last.
    problem: Arc<Mutex<String>>,
    token: Option<Declaration>,
    rows: Publisher,
    _rows: Declaration,
    _acks: Declaration,
}

impl FakeSession {
    fn open(carrier: &Carrier, session: &str) -> Self {
        let keys = ServerKeys::new("lab").session(session);
        let kept: Arc<Mutex<BTreeMap<u64, StepRecord>>> = Arc::default();
        let acked: Arc<Mutex<u64>> = Arc::default();
        let (held, key) = (Arc::clone(&kept), keys.truth_rows());
        let rows = carrier.serve(&keys.truth_rows(), Reach::Everywhere, move |query| {
            let StepRecordRequest { from_seq, count } =
                StepRecordRequest::decode(query.payload.clone()).expect("a request");
            // Like the server, from the first record that it has.
            for (_, truth) in held.lock().expect("a lock").range(from_seq..).take(count as usize) {
                query.reply(&key, "StepRecord", truth.encode_to_vec().into(), Vec::new()).expect("a reply");
            }
        });
        let problem: Arc<Mutex<String>> = Arc::default();
        let (held, seen, why) = (Arc::clone(&kept), Arc::clone(&acked), Arc::clone(&problem));
        let acks = carrier.subscribe(&keys.truth_ack(), Reach::Everywhere, move |message| {
            let ack = StepRecordAck::decode(message.payload).expect("an acknowledgement");
            let mut kept = held.lock().expect("a lock");
            *kept = kept.split_off(&ack.next_seq);
            let mut acked = seen.lock().expect("a lock");
            *acked = ack.next_seq.max(*acked);
            *why.lock().expect("a lock") = ack.problem;
        });
        let publisher = carrier.publisher(&keys.truth_row(), "StepRecord", Quality::default(), Reach::Everywhere);
        let token = carrier.token(&keys.truth_live(&token(session))).expect("a token");
        Self {
            rows: publisher.expect("a publisher"),
            kept,
            acked,
            problem,
            token: Some(token),
            _rows: rows.expect("a queryable"),
            _acks: acks.expect("a subscriber"),
        }
    }

    /// Sends truths; those that `is_sent` refuses are lost on the way.
    fn send(&self, truths: &[StepRecord], is_sent: impl Fn(u64) -> bool) {
        for truth in truths {
            self.kept.lock().expect("a lock").insert(truth.seq, truth.clone());
            if is_sent(truth.seq) {
                self.rows.put(truth.encode_to_vec().into(), Vec::new()).expect("sent");
            }
        }
    }
}

fn end(steps: u64) -> EpisodeEnd {
    EpisodeEnd { steps, ..EpisodeEnd::default() }
}

/// StepRecords of one episode of S01, the last with its result.
fn episode(first_seq: u64, episode: u64, rows: u64) -> Vec<StepRecord> {
    let header = |step| EpisodeHeader {
        protocol: Some(PROTOCOL),
        server: "lab".into(),
        session: "7".into(),
        task: if step == 0 { "S01".into() } else { String::new() },
        episode,
        ..EpisodeHeader::default()
    };
    let truth = |step| StepRecord {
        seq: first_seq + step,
        episode,
        step,
        header: (step == 0).then(|| header(step)),
        state: State { step, joint_position: vec![0.5; 53], ..State::default() }.encode_to_vec(),
        observation: Observation { episode, step, last_action: vec![1.0; 53], ..Observation::default() }
            .encode_to_vec(),
        result: (step + 1 == rows).then(|| EpisodeResult { end: Some(end(rows - 1)), ..EpisodeResult::default() }),
        ..StepRecord::default()
    };
    (0..rows).map(truth).collect()
}

/// The key that server and recorder share.
fn key() -> RecorderKey {
    static KEY: std::sync::OnceLock<RecorderKey> = std::sync::OnceLock::new();
    KEY.get_or_init(|| RecorderKey::generate().expect("a key")).clone()
}

fn token(session: &str) -> String {
    RowsKey::of_recorder(&key(), "lab", session).expect("a key").token()
}

fn folder(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../target/tmp/recorder").join(name);
    let _ = std::fs::remove_dir_all(&folder);
    folder
}

fn record(carrier: &Carrier, out: &Path) -> (Recorder, mpsc::Receiver<BagReport>) {
    let (sender, reports) = mpsc::channel();
    let options = RecorderOptions {
        out: out.into(),
        server: Some("lab".into()),
        name: "test".into(),
        naming: Naming::BySession,
        thin: false,
        records: RecordsFrom::ThisProcess(key()),
        on_bag: Box::new(move |report| drop(sender.send(report))),
        on_loss: Box::new(|_, _| ()),
    };
    (Recorder::start(carrier.clone(), options).expect("a recorder"), reports)
}

fn next(reports: &mpsc::Receiver<BagReport>) -> BagReport {
    reports.recv_timeout(Duration::from_secs(SECONDS)).expect("a bag in time")
}

/// Waits until all before a truth is acknowledged.
fn wait_for_ack(session: &FakeSession, next_seq: u64) {
    for _ in 0..SECONDS * 100 {
        if *session.acked.lock().expect("a lock") >= next_seq {
            return;
        }
        thread::sleep(Duration::from_millis(10));
    }
    panic!("acknowledged {}, not {next_seq}", session.acked.lock().expect("a lock"));
}

fn steps(path: &Path) -> Vec<u64> {
    let bag = Bag::open(path).expect("a bag");
    bag.states().map(|state| state.expect("a state").step).collect()
}

#[test]
fn sessions_become_bags_though_most_rows_are_lost_on_the_way() {
    let carrier = fiatlux_carrier::memory();
    let out = folder("lossy");
    let session = FakeSession::open(&carrier, "7");
    // Some were sent before there was a recorder.
    let (first, second) = (episode(0, 0, 300), episode(300, 1, 200));
    session.send(&first[..50], |_| true);
    let (recorder, reports) = record(&carrier, &out);
    session.send(&first[50..], |seq| seq % 7 == 0);
    session.send(&second, |seq| seq % 3 == 0);
    for (episode, rows) in [(0, 300), (1, 200)] {
        let report = next(&reports);
        assert_eq!(report.path, out.join(format!("lab/7/S01-s0-e{episode}.mcap")));
        assert!(matches!(report.end, BagEnd::Whole(_)), "{:?}", report.end);
        assert_eq!(Bag::open(&report.path).expect("a bag").completeness(), &Completeness::Whole);
        assert_eq!(steps(&report.path), Vec::from_iter(0..rows));
    }
    wait_for_ack(&session, 500);
    assert!(recorder.stop().is_empty());
}

#[test]
fn a_recorder_that_comes_back_goes_on() {
    let carrier = fiatlux_carrier::memory();
    let out = folder("again");
    let session = FakeSession::open(&carrier, "7");
    let truths = [episode(0, 0, 10), episode(10, 1, 400)].concat();
    let (recorder, reports) = record(&carrier, &out);
    session.send(&truths[..250], |_| true);
    next(&reports);
    wait_for_ack(&session, 10 + 128);
    let left = recorder.stop();
    assert_eq!(left, [part_of(&out.join("lab/7/S01-s0-e1.mcap"))]);
    session.send(&truths[250..300], |_| true);
    let (recorder, reports) = record(&carrier, &out);
    wait_for_ack(&session, 10 + 256);
    session.send(&truths[300..], |_| true);
    let report = next(&reports);
    assert!(matches!(report.end, BagEnd::Whole(_)), "{:?}", report.end);
    assert_eq!(steps(&report.path), Vec::from_iter(0..400));
    assert!(recorder.stop().is_empty() && !left[0].exists());
}

/// Guards the recorder that died after it finished a bag and before the server knew of it.
#[test]
fn a_bag_that_was_finished_is_not_written_again() {
    let carrier = fiatlux_carrier::memory();
    let out = folder("finished");
    for _ in 0..2 {
        let session = FakeSession::open(&carrier, "7");
        let (recorder, _reports) = record(&carrier, &out);
        session.send(&episode(0, 0, 20), |_| true);
        wait_for_ack(&session, 20);
        assert!(recorder.stop().is_empty());
    }
    let files =
        std::fs::read_dir(out.join("lab/7")).expect("the folder").map(|entry| entry.expect("a file").file_name());
    assert_eq!(Vec::from_iter(files), ["S01-s0-e0.mcap"]);
}

#[test]
fn what_cannot_be_had_any_more_cuts_the_bag_and_the_next_is_whole() {
    let carrier = fiatlux_carrier::memory();
    let out = folder("lost");
    let session = FakeSession::open(&carrier, "7");
    let (recorder, reports) = record(&carrier, &out);
    let truths = [episode(0, 0, 40), episode(40, 0, 30)].concat();
    session.send(&truths[..20], |_| true);
    session.send(&truths[25..], |_| true);
    let report = next(&reports);
    let BagEnd::Cut(reason) = &report.end else { panic!("{:?}", report.end) };
    assert!(reason.starts_with("5 rows were lost"), "{reason}");
    assert_eq!(steps(&report.path), Vec::from_iter(0..20));
    let report = next(&reports);
    assert_eq!(report.path, out.join("lab/7/S01-s0-e0-2.mcap"), "the name was taken");
    assert_eq!(steps(&report.path), Vec::from_iter(0..30));
    wait_for_ack(&session, 70);
    recorder.stop();
}

#[test]
fn a_server_that_goes_away_leaves_a_cut_bag() {
    let carrier = fiatlux_carrier::memory();
    let out = folder("away");
    let mut session = FakeSession::open(&carrier, "7");
    let (recorder, reports) = record(&carrier, &out);
    session.send(&episode(0, 0, 40)[..20], |_| true);
    thread::sleep(Duration::from_millis(500));
    session.token = None;
    let report = next(&reports);
    assert!(matches!(&report.end, BagEnd::Cut(reason) if reason.contains("went away")), "{:?}", report.end);
    assert_eq!(steps(&report.path), Vec::from_iter(0..20));
    recorder.stop();
}

/// Guards the network of a recorder against sessions that are opened and end at once: one of them is asked in each go, and those that
/// are there are asked first.
#[test]
fn sessions_that_are_gone_are_asked_last() {
    let carrier = fiatlux_carrier::memory();
    let (recorder, reports) = record(&carrier, &folder("gone"));
    let begun = Instant::now();
    let asked: Arc<Mutex<Vec<String>>> = Arc::default();
    let heard = Arc::clone(&asked);
    let any = ServerKeys::new("lab").session("*").truth_rows();
    let queries = carrier.serve(&any, Reach::Everywhere, move |query| heard.lock().expect("a lock").push(query.key));
    let _queries = queries.expect("a queryable");
    for number in 100..400 {
        let session = number.to_string();
        let token_key = ServerKeys::new("lab").session(&session).truth_live(&token(&session));
        drop(carrier.token(&token_key).expect("a token"));
    }
    let session = FakeSession::open(&carrier, "7");
    session.send(&episode(0, 0, 20), |_| false);
    assert!(matches!(next(&reports).end, BagEnd::Whole(_)), "it publishes nothing, and is asked");
    let goes = begun.elapsed().as_millis() as usize / 50 + 1;
    let own = ServerKeys::new("lab").session("7").truth_rows();
    let gone = asked.lock().expect("a lock").iter().filter(|key| **key != own).count();
    assert!(gone <= goes, "{gone} questions in {goes} goes");
    recorder.stop();
}

/// A bag that cannot be written is reported, and the server is told why, and not that it may forget the rows.
#[test]
fn what_is_on_no_disk_is_not_acknowledged() {
    let carrier = fiatlux_carrier::memory();
    let out = folder("full");
    std::fs::create_dir_all(out.join("lab")).expect("a folder");
    std::fs::write(out.join("lab/7"), "a file in place of the session's folder").expect("a file");
    let session = FakeSession::open(&carrier, "7");
    let (recorder, reports) = record(&carrier, &out);
    session.send(&episode(0, 0, 300), |_| true);
    let report = next(&reports);
    assert!(matches!(&report.end, BagEnd::Cut(reason) if reason.contains("space")), "{:?}", report.end);
    thread::sleep(Duration::from_millis(1500));
    assert_eq!(*session.acked.lock().expect("a lock"), 0);
    let problem = session.problem.lock().expect("a lock").clone();
    assert!(problem.contains("os error") && !problem.contains("lab/7"), "{problem}");
    std::fs::remove_file(out.join("lab/7")).expect("a file");
    session.send(&episode(300, 1, 10), |_| true);
    assert!(matches!(next(&reports).end, BagEnd::Whole(_)));
    wait_for_ack(&session, 310);
    assert_eq!(*session.problem.lock().expect("a lock"), "");
    recorder.stop();
}
