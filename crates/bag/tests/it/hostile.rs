//! Bags that are cut, damaged or made up.

use std::path::Path;

use crate::common::{Random, folder, header, push, result, state, write};
use fiatlux_bag::{Bag, BagError, BagWriter, Completeness, Patience, ROWS_PER_CHUNK};
use fiatlux_proto::v3::{EpisodeHeader, Sensor};

const ROWS: u64 = 4 * ROWS_PER_CHUNK + 40;

/// Steps after which a state chunk ends, with the byte after the chunk.
fn state_chunks(bytes: &[u8]) -> Vec<(u64, u64)> {
    let summary = mcap::Summary::read(bytes).expect("a summary").expect("a summary");
    let channel = summary.channels.values().find(|channel| channel.topic == "/state").expect("states").id;
    let with_states = summary.chunk_indexes.iter().filter(|c| c.message_index_offsets.contains_key(&channel));
    with_states.map(|c| (c.message_end_time / 20_000_000 + 1, c.chunk_start_offset + c.chunk_length)).collect()
}

#[test]
fn a_cut_file_gives_its_whole_chunks_and_says_that_it_is_cut() {
    let folder = folder("cut_anywhere");
    let bytes = std::fs::read(write(&folder.join("whole.mcap"), ROWS)).expect("bytes");
    let chunks = state_chunks(&bytes);
    let mut random = Random(3);
    let mut at: Vec<usize> = (0..20).map(|_| random.below(bytes.len())).collect();
    // And where a chunk has all its bytes but not its indexes.
    at.extend(chunks.iter().flat_map(|(_, end)| [*end as usize, *end as usize + 40]));
    at.extend([0, 3, 8, 100, bytes.len() - 1, bytes.len() - 40]);
    for cut in at {
        let path = folder.join(format!("{cut}.mcap"));
        std::fs::write(&path, &bytes[..cut]).expect("a cut file");
        let whole = chunks.iter().filter(|(_, end)| *end <= cut as u64).map(|(steps, _)| *steps).max().unwrap_or(0);
        match Bag::open(&path) {
            Ok(bag) => {
                let Completeness::Cut { next_step, reason } = bag.completeness() else { panic!("{cut} is not whole") };
                assert!(reason.contains(&format!("the file ends at byte {cut}")), "{reason}");
                assert_eq!(*next_step, whole, "cut at {cut}");
                let states: Result<Vec<_>, _> = bag.states().collect();
                assert_eq!(states.expect("states"), (0..whole).map(state).collect::<Vec<_>>(), "cut at {cut}");
                let observations = bag.observations().map(|read| read.expect("an observation"));
                assert!(observations.count() as u64 >= whole);
            }
            Err(error) => {
                assert!(cut < 3000, "{error}");
                assert!(matches!(error, BagError::NotABag { .. }), "{error}");
            }
        }
    }
}

#[test]
fn a_cut_file_is_taken_up_again() {
    let folder = folder("cut_again");
    let bytes = std::fs::read(write(&folder.join("whole.mcap"), ROWS)).expect("bytes");
    let mut random = Random(5);
    for _ in 0..10 {
        let cut = 20_000 + random.below(bytes.len() - 20_000);
        let path = folder.join(format!("{cut}.mcap"));
        std::fs::write(fiatlux_bag::part_of(&path), &bytes[..cut]).expect("a cut file");
        let mut writer = BagWriter::resume(&path).expect("taken up again").writer;
        let next_step = writer.next_step();
        push(&mut writer, next_step..ROWS);
        let path = writer.finish(&result(ROWS)).expect("a finished bag");
        assert!(std::fs::read(path).expect("bytes") == bytes, "{cut}");
    }
}

/// Reads all messages and counts them.
fn read_all(path: &Path) -> Result<usize, BagError> {
    let bag = Bag::open(path)?;
    let mut count = 0;
    for read in [
        bag.states().try_fold(0, |n, read| read.map(|_| n + 1)),
        bag.actions().try_fold(0, |n, read| read.map(|_| n + 1)),
        bag.observations().try_fold(0, |n, read| read.map(|_| n + 1)),
        bag.rewards().try_fold(0, |n, read| read.map(|_| n + 1)),
        bag.events().try_fold(0, |n, read| read.map(|_| n + 1)),
    ] {
        count += read?;
    }
    Ok(count)
}

#[test]
fn damage_never_panics() {
    let folder = folder("flips");
    let whole = folder.join("whole.mcap");
    let bytes = std::fs::read(write(&whole, ROWS)).expect("bytes");
    let count = read_all(&whole).expect("a whole bag");
    let (mut random, mut told) = (Random(11), 0);
    let path = folder.join("flipped.mcap");
    // Anywhere, among the lengths and names at the start, and in the summary.
    let rounds = [(0, 0, bytes.len()), (1, 0, 20_000), (2, bytes.len() - 8_000, 8_000)];
    for (round, from, length) in rounds.into_iter().flat_map(|round| vec![round; 400]) {
        let (at, bit) = (from + random.below(length), random.below(8));
        let mut flipped = bytes.clone();
        flipped[at] ^= 1 << bit;
        std::fs::write(&path, &flipped).expect("a flipped file");
        match read_all(&path) {
            Err(error) => {
                assert!(error.to_string().contains("flipped.mcap"), "{error}");
                told += 1;
            }
            Ok(read) => {
                // A change that is not noticed changes no message; messages may only be missing if the bag says that it
                // is cut.
                let bag = Bag::open(&path).expect("a bag");
                let cut = bag.completeness() != &Completeness::Whole;
                assert!(cut || read == count, "round {round}, bit {bit} of byte {at}: {read} of {count} messages");
                told += usize::from(cut);
            }
        }
    }
    assert!(told > 200, "only {told} of 1200 flips were noticed");
}

/// Every bit of a bag is under a checksum, a mark, or a length that must fit: whichever one changes, reading says so.
#[test]
fn every_flipped_bit_is_noticed() {
    let folder = folder("every_flip");
    let whole = folder.join("whole.mcap");
    let bytes = std::fs::read(write(&whole, ROWS)).expect("bytes");
    Bag::open(&whole).expect("a bag").check().expect("as it was written");
    check_read(&Bag::open(&whole).expect("a bag")).expect("as it was written");
    let mut random = Random(23);
    let path = folder.join("flipped.mcap");
    let header_end = 9_000;
    let summary = bytes.len() - 8_000;
    let anywhere = (0..500).map(|_| random.below(8 * bytes.len())).collect::<Vec<_>>();
    let in_header = (0..300).map(|_| random.below(8 * header_end)).collect::<Vec<_>>();
    let in_summary = (0..300).map(|_| 8 * summary + random.below(8 * 8_000)).collect::<Vec<_>>();
    // And each bit of the last records, where the checksums themselves stand.
    let at_the_end = (8 * (bytes.len() - 60)..8 * bytes.len()).collect();
    for bit in [anywhere, in_header, in_summary, at_the_end, data_end(&bytes)].into_iter().flatten() {
        let mut flipped = bytes.clone();
        flipped[bit / 8] ^= 1 << (bit % 8);
        std::fs::write(&path, &flipped).expect("a flipped file");
        let is_noticed = match Bag::open(&path) {
            Err(_) => true,
            Ok(bag) => {
                bag.completeness() != &Completeness::Whole || (bag.check().is_err() && check_read(&bag).is_err())
            }
        };
        assert!(is_noticed, "bit {} of byte {} of {}", bit % 8, bit / 8, bytes.len());
    }
}

/// Reads the states, then checks the rest.
fn check_read(bag: &Bag) -> Result<(), BagError> {
    let mut states = bag.states();
    states.by_ref().try_for_each(|state| state.map(drop))?;
    bag.check_rest(&states.into_read())
}

/// Each bit of the record that ends the data section.
fn data_end(bytes: &[u8]) -> Vec<usize> {
    let mut at = 8;
    while bytes[at] != mcap::records::op::DATA_END {
        at += 9 + u64::from_le_bytes(bytes[at + 1..at + 9].try_into().expect("8 bytes")) as usize;
    }
    (8 * at..8 * (at + 13)).collect()
}

/// A copy of a bag, written anew with other metadata; checksums only under the name of our own writer.
fn rewritten(name: &str, library: &str, change: impl Fn(&mut Vec<mcap::records::Metadata>)) -> std::path::PathBuf {
    let folder = folder(name);
    let bytes = std::fs::read(write(&folder.join("whole.mcap"), ROWS)).expect("bytes");
    let summary = mcap::Summary::read(&bytes).expect("a summary").expect("a summary");
    let metadata = summary.metadata_indexes.iter().map(|index| {
        let record = &bytes[index.offset as usize + 9..(index.offset + index.length) as usize];
        match mcap::parse_record(0x0c, record).expect("a record") {
            mcap::records::Record::Metadata(metadata) => metadata,
            other => panic!("{other:?}"),
        }
    });
    let mut metadata: Vec<_> = metadata.collect();
    change(&mut metadata);
    let path = folder.join("rewritten.mcap");
    let sums = library == "fiatlux 1";
    let options = mcap::WriteOptions::new().profile("fiatlux").library(library).compression_threads(0);
    let options = options.calculate_data_section_crc(sums).calculate_summary_section_crc(sums);
    let mut writer = options.create(std::fs::File::create(&path).expect("a file")).expect("a writer");
    for record in &metadata {
        writer.write_metadata(record).expect("metadata");
    }
    for message in mcap::MessageStream::new(&bytes).expect("messages") {
        writer.write(&message.expect("a message")).expect("written");
    }
    writer.finish().expect("a finished file");
    path
}

#[test]
fn only_another_writer_may_leave_checksums_out() {
    let other = Bag::open(rewritten("other_writer", "other", |_| ())).expect("a bag");
    assert_eq!(other.completeness(), &Completeness::Whole);
    other.check().expect("no checksum is wrong");
    let path = rewritten("no_sums", "fiatlux!", |_| ());
    let error = Bag::open(&path).expect("a bag").check().expect_err("no checksums").to_string();
    assert!(error.contains("the checksum of its data section is 00000000"), "{error}");
    assert!(error.contains("was changed after it was recorded, or damaged on the way, at byte 0: "), "{error}");
}

/// Guards that two copies of the same data must agree, and that neither may be missing.
#[test]
fn doubles_must_agree() {
    rewritten_is("same", |_| (), None);
    let other_result = |metadata: &mut Vec<mcap::records::Metadata>| {
        metadata[1].metadata.insert("total_reward".into(), "7.5".into());
    };
    rewritten_is("other_result", other_result, Some("the result in its metadata is not the one on /result"));
    let extra = |metadata: &mut Vec<mcap::records::Metadata>| {
        metadata[0].metadata.insert("score".into(), "1.0".into());
    };
    rewritten_is("extra_field", extra, Some("a field 'score', which this protocol does not define"));
    let second = |metadata: &mut Vec<mcap::records::Metadata>| {
        let mut header = metadata[0].clone();
        header.metadata.insert("task".into(), "S06".into());
        metadata.insert(0, header);
    };
    let bag = Bag::open(rewritten("second_header", "fiatlux 1", second)).expect("a bag");
    let Completeness::Cut { reason, .. } = bag.completeness() else { panic!("two headers") };
    assert!(reason.contains("repeats an earlier one"), "{reason}");
}

fn rewritten_is(name: &str, change: impl Fn(&mut Vec<mcap::records::Metadata>), expected: Option<&str>) {
    let bag = Bag::open(rewritten(name, "fiatlux 1", change)).expect("a bag");
    assert_eq!(bag.check().is_ok(), check_read(&bag).is_ok(), "{name}");
    match (bag.check(), expected) {
        (Ok(()), None) => {}
        (Err(error), Some(expected)) => assert!(error.to_string().contains(expected), "{name}: {error}"),
        (found, _) => panic!("{name}: {found:?}"),
    }
}

#[test]
fn made_up_bytes_never_panic() {
    let folder = folder("made_up");
    let bytes = std::fs::read(write(&folder.join("whole.mcap"), 40)).expect("bytes");
    let mut random = Random(17);
    let path = folder.join("made_up.mcap");
    for round in 0..200 {
        let mut made_up: Vec<u8> = (0..random.below(4000)).map(|_| random.below(256) as u8).collect();
        if round % 2 == 0 {
            made_up = [&bytes[..8 + random.below(bytes.len() - 8)], &made_up].concat();
        }
        std::fs::write(&path, &made_up).expect("a made-up file");
        let _ = read_all(&path);
    }
}

/// A file with this header, written by hand: `fill` gets the writer and the channel of a topic.
fn by_hand(
    name: &str,
    header: &EpisodeHeader,
    topic: &str,
    fill: impl FnOnce(&mut RawWriter, u16),
) -> std::path::PathBuf {
    let path = folder(name).join("a.mcap");
    let options = mcap::WriteOptions::new().chunk_size(None).compression_threads(0);
    let mut writer = options.create(std::fs::File::create(&path).expect("a file")).expect("a writer");
    let small = BagWriter::create(&path.with_extension("small"), header).expect("a bag");
    let small = std::fs::read(small.finish(&result(1)).expect("a finished bag")).expect("bytes");
    let summary = mcap::Summary::read(&small).expect("a summary").expect("a summary");
    let index = &summary.metadata_indexes[0];
    let record = &small[index.offset as usize + 9..(index.offset + index.length) as usize];
    let Ok(mcap::records::Record::Metadata(metadata)) = mcap::parse_record(0x0c, record) else { panic!("metadata") };
    writer.write_metadata(&metadata).expect("metadata");
    let schema = writer.add_schema("fiatlux.v3.State", "protobuf", &[]).expect("a schema");
    let channel = writer.add_channel(schema, topic, "protobuf", &Default::default()).expect("a channel");
    fill(&mut writer, channel);
    writer.finish().expect("a finished file");
    path
}

type RawWriter = mcap::Writer<std::fs::File>;

/// Writes a message of zeros as a chunk of its own.
fn zeros(writer: &mut RawWriter, channel_id: u16, bytes: usize) {
    let header = mcap::records::MessageHeader { channel_id, sequence: 0, log_time: 0, publish_time: 0 };
    writer.write_to_known_channel(&header, &vec![0; bytes]).expect("a message");
    writer.flush().expect("a chunk");
}

/// Guards that a chunk that claims to be larger than a recorder's is not unpacked.
#[test]
fn a_bomb_is_refused() {
    let path = by_hand("bomb", &header(), "/state", |writer, channel| zeros(writer, channel, 100 << 20));
    assert!(std::fs::metadata(&path).expect("a file").len() < 1 << 20);
    let bag = Bag::open(&path).expect("the header is fine");
    assert!(matches!(bag.completeness(), Completeness::Cut { .. }));
    assert_eq!(bag.states().count(), 0);
}

/// Guards against many small bombs, each of which may be unpacked: their sum is bounded before the first one is.
#[test]
fn many_small_bombs_are_refused() {
    let path = by_hand("bombs", &header(), "/observation", |writer, channel| {
        (0..20).for_each(|_| zeros(writer, channel, 30 << 20));
    });
    let error = Bag::open(&path).expect_err("600 MB").to_string();
    assert!(error.contains("bytes unpack to 629") && error.contains("may unpack to"), "{error}");
}

/// Guards against topics that no recorder writes, and sensors that the header does not promise: nobody reads them.
#[test]
fn topics_that_the_header_does_not_promise_are_refused() {
    let opened = |name, header: &EpisodeHeader, topic| {
        let path = by_hand(name, header, topic, |writer, channel| zeros(writer, channel, 8));
        Bag::open(path).map(drop).map_err(|error| error.to_string())
    };
    let error = opened("foreign", &header(), "/zeros\x1b").expect_err("no such topic");
    assert!(error.contains(r"messages on '/zeros\u001b', a topic that no recorder writes"), "{error}");
    for topic in ["/camera", "/lidar"] {
        let sensor = |recorded| Sensor { name: topic[1..].into(), recorded, ..Sensor::default() };
        let with = |recorded| EpisodeHeader { sensors: vec![sensor(recorded)], ..header() };
        let error = opened("unpromised", &with(false), topic).expect_err("not recorded");
        assert!(error.contains(topic) && error.contains("no sensor of its header"), "{error}");
        opened("promised", &with(true), topic).expect("recorded");
    }
}

/// Guards the errors for files of another program, which must not be those for a damaged disk.
#[test]
fn what_another_program_wrote_is_named() {
    let folder = folder("named");
    let bytes = std::fs::read(write(&folder.join("whole.mcap"), 40)).expect("bytes");
    let reason = |name: &str, bytes: &[u8]| {
        let path = folder.join(name);
        std::fs::write(&path, bytes).expect("written");
        let bag = Bag::open(&path).expect("a header");
        let Completeness::Cut { reason, .. } = bag.completeness() else { panic!("{name} is whole") };
        reason.clone()
    };
    // The name of the compression stands in the head of each chunk.
    let mut other = bytes.clone();
    let at = bytes.windows(4).position(|name| name == b"zstd").expect("a chunk");
    other[at..at + 4].copy_from_slice(b"lz4\x1b");
    assert!(reason("lz4.mcap", &other).contains(r"compressed by 'lz4\u001b'; a recorder compresses by zstd"));
    other[at - 4..at].copy_from_slice(&[0; 4]);
    assert!(reason("plain.mcap", &other).contains("compressed not at all"));
    // The footer is the last record before the end mark: operation code, length, start of the summary.
    let start = bytes.len() - 8 - 20;
    for wrong in [1, u64::MAX, bytes.len() as u64] {
        let mut other = bytes.clone();
        other[start..start + 8].copy_from_slice(&wrong.to_le_bytes());
        let reason = reason("footer.mcap", &other);
        assert!(reason.contains(&format!("a footer that puts the summary at byte {wrong}")), "{reason}");
    }
}

/// Guards that reading a stranger's bag can be stopped in the middle.
#[test]
fn reading_ends_with_its_patience() {
    let path = write(&folder("patience").join("a.mcap"), ROWS);
    let asked = std::sync::atomic::AtomicU32::new(0);
    let patience = Patience::new(move || asked.fetch_add(1, std::sync::atomic::Ordering::Relaxed) < 100);
    let bag = Bag::open(path).expect("a bag").with_patience(Some(patience));
    let read: Vec<_> = bag.states().collect();
    assert!(read.len() < 200, "{} rows", read.len());
    assert!(matches!(read.last(), Some(Err(BagError::Slow { .. }))));
}
