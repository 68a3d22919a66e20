use fiatlux_proto::ABORTED;
use fiatlux_proto::v3::{EpisodeEnd, StepRecordRequest};

use super::*;

const NOW: Duration = Duration::from_secs(100);

fn header(episode: u64) -> EpisodeHeader {
    EpisodeHeader { task: "S01".into(), episode, ..EpisodeHeader::default() }
}

/// Records of one episode; the last has the result.
fn episode(first_seq: u64, episode: u64, rows: u64) -> Vec<StepRecord> {
    let row = |step| StepRecord {
        seq: first_seq + step,
        episode,
        step,
        state: vec![1],
        header: (step == 0).then(|| header(episode)),
        result: (step + 1 == rows).then(EpisodeResult::default),
        ..StepRecord::default()
    };
    (0..rows).map(row).collect()
}

/// A recorder without files or a network.
struct Harness {
    session: RecorderSession,
    now: Duration,
    /// Written so far: `o` for a new bag, steps, `f` for its end, `c` for a cut.
    written: Vec<String>,
    request: Option<StepRecordRequest>,
    /// Number of records that it reported as lost.
    lost: u64,
    is_done: bool,
}

impl Harness {
    fn new() -> Self {
        Self::of(RecorderSession::new("r", NOW))
    }

    /// A recorder with the rows before step 4 of episode 0 on disk.
    fn resumed() -> Self {
        let mut recorder = Self::of(RecorderSession::resume("r", header(0), 4, NOW));
        recorder.give(Input::OnDisk(4));
        recorder
    }

    fn of(session: RecorderSession) -> Self {
        Self { session, now: NOW, written: Vec::new(), request: None, lost: 0, is_done: false }
    }

    fn give(&mut self, input: Input) {
        self.session.handle(input, self.now);
        while let Some(output) = self.session.poll() {
            match output {
                Output::Write(Write::Open(header)) => self.written.push(format!("o{}", header.episode)),
                Output::Write(Write::Row(record)) => self.written.push(record.step.to_string()),
                Output::Write(Write::Finish(_)) => self.written.push("f".into()),
                Output::Write(Write::Cut(reason)) => {
                    assert!(!reason.is_empty());
                    self.written.push("c".into());
                }
                Output::Request(bytes) => self.request = Some(StepRecordRequest::decode(bytes).expect("a request")),
                Output::Ack(bytes) => {
                    assert_eq!(StepRecordAck::decode(bytes).expect("an acknowledgement").recorder, "r");
                }
                Output::Lost(records) => self.lost += records,
                Output::Done => self.is_done = true,
            }
        }
    }

    fn take(&mut self, records: impl IntoIterator<Item = StepRecord>) {
        records.into_iter().for_each(|record| self.give(Input::StepRecord(record.encode_to_vec().into())));
    }

    /// The request that it makes now.
    fn request(&mut self) -> Option<StepRecordRequest> {
        self.give(Input::Tick);
        self.request.take()
    }

    /// Number of the first record that is not on disk, if the open bag has all rows before a step on disk.
    fn next_seq(&mut self, on_disk: u64) -> u64 {
        self.give(Input::OnDisk(on_disk));
        self.session.next_seq()
    }

    /// Written since the last call.
    fn written(&mut self) -> String {
        std::mem::take(&mut self.written).join(" ")
    }
}

#[test]
fn episodes_become_bags_whatever_the_order() {
    let mut recorder = Harness::new();
    let mut records = [episode(0, 0, 3), episode(3, 1, 2)].concat();
    records.reverse();
    recorder.take(records.clone());
    recorder.take(records);
    assert_eq!(recorder.written(), "o0 0 1 2 f o1 0 1 f");
    assert_eq!((recorder.next_seq(0), recorder.session.open.is_some()), (5, false));
}

#[test]
fn only_what_is_on_disk_is_acknowledged() {
    let mut recorder = Harness::new();
    recorder.take(episode(0, 0, 2));
    recorder.take(episode(2, 1, 300).into_iter().take(200));
    recorder.written();
    assert_eq!((recorder.next_seq(0), recorder.next_seq(128)), (2, 2 + 128));
}

#[test]
fn an_episode_without_a_last_row_ends_too() {
    let mut recorder = Harness::new();
    let end = EpisodeEnd { cause: ABORTED.into(), ..EpisodeEnd::default() };
    let result = Some(EpisodeResult { end: Some(end), ..EpisodeResult::default() });
    let mut records = episode(0, 0, 5);
    records.truncate(3);
    records.push(StepRecord { seq: 3, step: 2, result, ..StepRecord::default() });
    recorder.take(records);
    assert_eq!(recorder.written(), "o0 0 1 2 2 f");
    assert_eq!(recorder.next_seq(0), 4);
}

#[test]
fn another_episode_cuts_the_one_before() {
    let mut recorder = Harness::new();
    recorder.take(episode(0, 0, 9).into_iter().take(3));
    recorder.take(episode(3, 0, 2));
    assert_eq!(recorder.written(), "o0 0 1 2 c o0 0 1 f");
}

#[test]
fn without_its_first_row_an_episode_has_no_bag() {
    let mut recorder = Harness::new();
    let mut first = episode(0, 0, 3);
    first[0].header = None;
    recorder.take(first);
    recorder.take(episode(3, 1, 1));
    assert_eq!(recorder.written(), "o1 0 f");
}

#[test]
fn lost_rows_cut_the_bag_and_the_next_episode_is_whole() {
    let mut recorder = Harness::new();
    recorder.take(episode(0, 0, 9).into_iter().take(3));
    recorder.take(episode(9, 1, 2));
    assert_eq!(recorder.written(), "o0 0 1 2");
    let mut all = String::new();
    while all.is_empty() {
        assert!(recorder.request().is_some() && recorder.now < NOW + Duration::from_secs(20));
        recorder.give(Input::Answered);
        recorder.now += Duration::from_secs(1);
        all = recorder.written();
    }
    assert_eq!(all, "c o1 0 1 f");
}

#[test]
fn records_that_are_in_no_bag_are_told() {
    let mut recorder = Harness::new();
    recorder.take(episode(9, 1, 2));
    while recorder.lost == 0 {
        assert!(recorder.request().is_some() && recorder.now < NOW + Duration::from_secs(20));
        recorder.give(Input::Answered);
        recorder.now += Duration::from_secs(1);
    }
    assert_eq!((recorder.lost, recorder.written().as_str()), (9, "o1 0 1 f"));
}

#[test]
fn a_bag_is_taken_up_where_it_was_left() {
    // The server still has rows that are on disk, with or without the first one.
    for first_kept in [0, 2, 4] {
        let mut recorder = Harness::resumed();
        assert_eq!(recorder.next_seq(4), 0, "nothing is known yet");
        assert!(recorder.request().is_some());
        recorder.take(episode(0, 0, 6).into_iter().skip(first_kept));
        recorder.give(Input::Answered);
        assert_eq!(recorder.written(), "4 5 f", "from {first_kept}");
        assert_eq!(recorder.next_seq(0), 6);
    }
}

/// Guards a recorder that died between two bags: what the server has forgotten is not lost.
#[test]
fn a_recorder_goes_on_between_two_bags() {
    let mut recorder = Harness::of(RecorderSession::again("r", NOW));
    assert!(recorder.request().is_some());
    recorder.take(episode(100, 3, 2));
    recorder.give(Input::Answered);
    assert_eq!((recorder.written(), recorder.lost, recorder.next_seq(0)), ("o3 0 1 f".into(), 0, 102));
}

/// Guards a recorder that died just after it had begun a bag: the end of the bag before comes again.
#[test]
fn a_recorder_goes_on_at_the_beginning_of_a_bag() {
    let mut recorder = Harness::of(RecorderSession::resume("r", header(1), 0, NOW));
    assert!(recorder.request().is_some());
    recorder.take(episode(0, 0, 3).into_iter().skip(1).chain(episode(3, 1, 2)));
    recorder.give(Input::Answered);
    assert_eq!((recorder.written(), recorder.next_seq(0)), ("0 1 f".into(), 5));
}

/// Guards a recorder that died while it finished a bag, and again just after it took it up: rows that its new file does
/// not have yet are not acknowledged.
#[test]
fn what_a_resumed_bag_has_in_memory_is_not_acknowledged() {
    let mut recorder = Harness::of(RecorderSession::resume("r", header(0), 4, NOW));
    assert!(recorder.request().is_some());
    recorder.take(episode(0, 0, 9).into_iter().take(3));
    recorder.give(Input::Answered);
    assert_eq!((recorder.written(), recorder.session.next_seq()), (String::new(), 0));
}

/// Guards a recorder that died with all rows on disk, but without the result.
#[test]
fn the_result_alone_ends_a_resumed_bag() {
    let mut recorder = Harness::resumed();
    assert!(recorder.request().is_some());
    recorder.take(episode(0, 0, 4));
    recorder.give(Input::Answered);
    assert_eq!((recorder.written(), recorder.next_seq(0)), ("f".into(), 4));
}

#[test]
fn a_bag_that_cannot_go_on_is_cut() {
    // A row is missing; the session is at another episode; it is another session of the same name.
    let other = EpisodeHeader { seed: 1, ..header(0) };
    let with_other: Vec<StepRecord> = episode(0, 0, 2)
        .into_iter()
        .map(|mut record| {
            record.header = record.header.map(|_| other.clone());
            record
        })
        .collect();
    let cases = [(episode(0, 0, 7).split_off(5), "c"), (episode(600, 1, 2), "c o1 0 1 f"), (with_other, "c o0 0 1 f")];
    for (records, expected) in cases {
        let mut recorder = Harness::resumed();
        while let Some(request) = recorder.request() {
            let asked = request.from_seq..request.from_seq + request.count;
            recorder.take(records.iter().filter(|record| asked.contains(&record.seq)).cloned());
            recorder.give(Input::Answered);
        }
        assert_eq!(recorder.written(), expected);
    }
}

#[test]
fn what_is_on_disk_is_acknowledged_in_time() {
    let mut session = RecorderSession::new("r", NOW);
    let acks = |session: &mut RecorderSession, input, now| -> Vec<u64> {
        session.handle(input, now);
        let outputs = std::iter::from_fn(|| session.poll());
        let ack = |output| match output {
            Output::Ack(bytes) => Some(StepRecordAck::decode(bytes).expect("an acknowledgement").next_seq),
            _ => None,
        };
        outputs.filter_map(ack).collect()
    };
    assert_eq!(acks(&mut session, Input::Tick, NOW), [0], "the first one registers the recorder");
    for record in episode(0, 0, 500).into_iter().take(200) {
        let input = Input::StepRecord(record.encode_to_vec().into());
        assert!(acks(&mut session, input, NOW).is_empty(), "nothing is on disk");
    }
    assert_eq!(acks(&mut session, Input::OnDisk(128), NOW), [128]);
    assert!(acks(&mut session, Input::OnDisk(140), NOW).is_empty(), "few can wait");
    let later = session.wake_at().expect("it wants to tell");
    assert!(later <= NOW + ACK_PERIOD / 2);
    assert_eq!(acks(&mut session, Input::Tick, later), [140]);
}

#[test]
fn a_server_that_is_gone_leaves_a_cut_bag_and_its_session_is_done() {
    let mut recorder = Harness::new();
    recorder.take(episode(0, 0, 9).into_iter().take(3));
    recorder.give(Input::ServerGone);
    recorder.now += SERVER_TIMEOUT / 2;
    recorder.give(Input::ServerSeen);
    recorder.give(Input::ServerGone);
    recorder.now += SERVER_TIMEOUT - Duration::from_nanos(1);
    recorder.give(Input::Tick);
    assert_eq!(recorder.written(), "o0 0 1 2", "it may come back");
    recorder.now += Duration::from_nanos(1);
    recorder.give(Input::Tick);
    assert_eq!((recorder.written().as_str(), recorder.is_done), ("c", true));
    assert_eq!(recorder.session.wake_at(), None);
}

#[test]
fn a_bag_that_cannot_be_written_is_given_up() {
    let mut recorder = Harness::new();
    recorder.take(episode(0, 0, 9).into_iter().take(3));
    recorder.give(Input::WriteFailed("full".into()));
    recorder.take(episode(0, 0, 9).into_iter().skip(3));
    recorder.take(episode(9, 1, 2));
    assert_eq!(recorder.written(), "o0 0 1 2 o1 0 1 f");
    assert_eq!(recorder.next_seq(0), 11);
}

/// Guards a full disk: the server is never told that it may forget what is not on disk.
#[test]
fn what_could_not_be_written_is_not_acknowledged() {
    let failing = |rows_before: u64, fails_at: &str| {
        let mut session = RecorderSession::new("r", NOW);
        let (mut acked, mut now) = (0, NOW);
        let records = [episode(0, 0, 4), episode(4, 1, 300), episode(304, 2, 2)].concat();
        let mut after_loss = Vec::new();
        for record in records {
            let seq = record.seq;
            now += ACK_PERIOD;
            session.handle(Input::StepRecord(record.encode_to_vec().into()), now);
            while let Some(output) = session.poll() {
                match output {
                    Output::Write(write) => {
                        let name = match &write {
                            Write::Open(header) => format!("o{}", header.episode),
                            Write::Row(row) => format!("{}/{}", row.episode, row.step),
                            Write::Finish(_) => "f".into(),
                            Write::Cut(_) => "c".into(),
                        };
                        // Only this many rows of an open bag are on disk.
                        let on_disk = if (5..304).contains(&seq) { rows_before } else { 0 };
                        let fails = name == fails_at && seq >= 4;
                        session.handle(
                            if fails { Input::WriteFailed("full".into()) } else { Input::OnDisk(on_disk) },
                            now,
                        );
                    }
                    Output::Ack(bytes) => acked = StepRecordAck::decode(bytes).expect("an acknowledgement").next_seq,
                    _ => {}
                }
            }
            if seq == 303 {
                after_loss.push(acked);
            }
        }
        after_loss.push(acked);
        after_loss
    };
    // The bag cannot be created, or a row or the end of it cannot be written.
    assert_eq!(failing(0, "o1"), [4, 306]);
    assert_eq!(failing(0, "1/0"), [4, 306]);
    assert_eq!(failing(128, "1/200"), [4 + 128, 306]);
    assert_eq!(failing(256, "f"), [4 + 256, 304], "nor is the last one, which failed too");
}
