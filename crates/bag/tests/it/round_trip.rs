//! Bags read back as they were written.

use crate::common::{folder, header, push, result, state, truth, write};
use fiatlux_bag::{Bag, BagError, BagWriter, Completeness, ROWS_PER_CHUNK, part_of};
use fiatlux_proto::Message;
use fiatlux_proto::v3::{ActionRecord, EpisodeHeader, EpisodeResult};

const ROWS: u64 = 3 * ROWS_PER_CHUNK + 17;

#[test]
fn everything_reads_back() {
    let path = write(&folder("everything").join("a.mcap"), ROWS);
    let bag = Bag::open(&path).expect("a bag");
    assert_eq!(bag.header(), &header());
    assert_eq!(bag.result(), Some(&result(ROWS)));
    assert_eq!(bag.completeness(), &Completeness::Whole);
    let states: Result<Vec<_>, _> = bag.states().collect();
    assert_eq!(states.expect("states"), (0..ROWS).map(state).collect::<Vec<_>>());
    let mut states = bag.states();
    for step in 0..ROWS {
        let read = states.next().expect("a row").expect("a state");
        assert_eq!(read, state(step));
        states.reuse(read);
    }
    let actions: Vec<_> = bag.actions().map(|action| action.expect("an action")).collect();
    assert_eq!(actions.len() as u64, ROWS - 1);
    assert_eq!(actions[6], ActionRecord::decode(truth(7).action.as_slice()).expect("an action"));
    assert_eq!(bag.observations().filter(|read| read.is_ok()).count() as u64, ROWS);
    assert_eq!(bag.rewards().map(|reward| reward.expect("a reward").step).collect::<Vec<_>>(), Vec::from_iter(1..ROWS));
    assert_eq!(bag.events().filter(|read| read.is_ok()).count() as u64, 2 * ROWS.div_ceil(10));
    assert_eq!(bag.frames().filter(|read| read.is_ok()).count() as u64, ROWS.div_ceil(2));
    assert_eq!(bag.scenes().filter(|read| read.is_ok()).count(), 1);
}

/// The `mcap` crate's reader, which knows nothing of this project: summary, indexes, checksums and order of messages.
#[test]
fn the_mcap_reader_finds_all_in_order() {
    let path = write(&folder("order").join("a.mcap"), ROWS);
    let bytes = std::fs::read(path).expect("the bag's bytes");
    let summary = mcap::Summary::read(&bytes).expect("a summary").expect("a summary");
    let counts = summary.stats.as_ref().expect("statistics");
    let messages: Vec<_> = mcap::MessageStream::new(&bytes).expect("messages").map(|m| m.expect("a message")).collect();
    assert_eq!(counts.message_count, messages.len() as u64);
    assert_eq!(counts.metadata_count, 2);
    assert_eq!(summary.metadata_indexes[0].name, "fiatlux");
    assert_eq!(messages.last().expect("messages").channel.topic, "/result");
    for message in &messages {
        assert_eq!(
            (message.log_time, message.publish_time),
            (u64::from(message.sequence) * 20_000_000, message.log_time)
        );
    }
    for index in &summary.chunk_indexes {
        assert!(summary.stream_chunk(&bytes, index).expect("a chunk").all(|message| message.is_ok()));
    }
}

#[test]
fn the_same_episode_gives_the_same_bytes() {
    let folder = folder("same_rows");
    let bytes = ["a.mcap", "b.mcap"].map(|name| std::fs::read(write(&folder.join(name), ROWS)).expect("bytes"));
    assert!(bytes[0] == bytes[1]);
}

#[test]
fn names() {
    let folder = folder("names");
    let path = folder.join("deep/er/a.mcap");
    let writer = BagWriter::create(&path, &header()).expect("a new bag");
    assert!(part_of(&path).exists() && !path.exists());
    assert!(matches!(BagWriter::create(&path, &header()), Err(BagError::Exists { .. })));
    writer.finish(&result(1)).expect("a finished bag");
    assert!(!part_of(&path).exists() && path.exists());
    assert!(matches!(BagWriter::create(&path, &header()), Err(BagError::Exists { .. })));
    let error = Bag::open(folder.join("none.mcap")).expect_err("no such bag").to_string();
    assert!(error.starts_with("cannot open ") && error.contains("none.mcap"), "{error}");
}

/// Guards that a part without a whole header is replaced, and that one that is being written, or has other content, is
/// not.
#[test]
fn a_part_without_a_whole_header_is_taken_over() {
    let path = folder("begun").join("a.mcap");
    let write = |bytes: &[u8]| std::fs::write(part_of(&path), bytes).expect("a part");
    let is_taken_over = || BagWriter::create(&path, &header()).is_ok();
    write(&[]);
    assert!(is_taken_over());
    let begun = std::fs::read(part_of(&path)).expect("bytes");
    assert!(!is_taken_over(), "it has a header");
    for length in [1, 41, 4096, begun.len() - 1] {
        write(&begun[..length]);
        assert!(is_taken_over(), "{length}");
        assert!(std::fs::read(part_of(&path)).expect("bytes") == begun, "{length}");
        write(&[&begun[..length], b"?"].concat());
        assert!(!is_taken_over(), "{length} and something else");
    }
    write(&begun[..41]);
    let other = std::fs::File::open(part_of(&path)).expect("the part");
    other.lock().expect("nobody has it");
    assert!(!is_taken_over(), "somebody is about to write");
}

#[test]
fn what_metadata_cannot_hold_is_refused() {
    let path = folder("values").join("a.mcap");
    let odd = EpisodeHeader { control_dt: f64::NAN, ..header() };
    assert!(matches!(BagWriter::create(&path, &odd), Err(BagError::Values { what: "header" })));
    let writer = BagWriter::create(&path, &header()).expect("a new bag");
    let odd = EpisodeResult { total_reward: f64::INFINITY, ..result(1) };
    assert!(matches!(writer.finish(&odd), Err(BagError::Values { what: "result" })));
}

#[test]
fn a_bag_that_could_not_be_completed_says_why() {
    let path = folder("cut").join("a.mcap");
    let mut writer = BagWriter::create(&path, &header()).expect("a new bag");
    push(&mut writer, 0..200);
    let bag = Bag::open(writer.finish_cut("the server went away").expect("a finished bag")).expect("a bag");
    let reason = "the server went away".into();
    assert_eq!(bag.completeness(), &Completeness::Cut { reason, next_step: 200 });
    assert_eq!((bag.result(), bag.states().count()), (None, 200));
}

/// Guards that a resumed bag equals an uninterrupted one, byte for byte.
#[test]
fn a_bag_is_taken_up_again() {
    let folder = folder("again");
    let whole = std::fs::read(write(&folder.join("whole.mcap"), ROWS)).expect("bytes");
    for left_after in [0, 1, ROWS_PER_CHUNK, ROWS_PER_CHUNK + 50, ROWS - 1, ROWS] {
        let path = folder.join(format!("{left_after}.mcap"));
        let mut writer = BagWriter::create(&path, &header()).expect("a new bag");
        push(&mut writer, 0..left_after);
        assert_eq!(writer.next_step(), left_after);
        assert_eq!(writer.next_step_on_disk(), left_after - left_after % ROWS_PER_CHUNK);
        if left_after == ROWS_PER_CHUNK + 50 {
            writer.flush().expect("flushed");
        }
        let on_disk = writer.next_step_on_disk();
        drop(writer);
        let resumed = BagWriter::resume(&path).expect("taken up again");
        assert_eq!(resumed.header, header());
        let mut writer = resumed.writer;
        assert_eq!(writer.next_step(), on_disk);
        push(&mut writer, on_disk..ROWS);
        let path = writer.finish(&result(ROWS)).expect("a finished bag");
        assert!(std::fs::read(path).expect("bytes") == whole, "{left_after}");
    }
}
