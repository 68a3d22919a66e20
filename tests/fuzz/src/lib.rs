//! Shared by the targets: bags in parts, seeds, and a folder in memory.
//!
//! A bag in parts is a list of messages, each behind a byte for its kind and four for its length. Its digests are made anew
//! before it is graded: bytes that a fuzzer changed would else be found out by the first checksum.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

use fiatlux_bag::{Bag, BagWriter, topic};
use fiatlux_proto::Message;
use fiatlux_proto::v3::{EpisodeHeader, EpisodeResult, State};
use fiatlux_wire::{header_digest, layout_of, read_identity, read_row};

/// Topics of the messages by their kind; the last two are header and result.
const TOPICS: [&str; 5] = [topic::STATE, topic::ACTION, topic::EVENT, topic::OBSERVATION, topic::REWARD];
const HEADER: u8 = 5;
const RESULT: u8 = 6;
/// Most rows of a seed: what is small is changed often.
const SEED_ROWS: usize = 4;

/// A folder of this process, in memory where the system has one.
pub fn folder(name: &str) -> PathBuf {
    let memory = Path::new("/dev/shm");
    let root = if memory.is_dir() { memory.to_path_buf() } else { std::env::temp_dir() };
    let folder = root.join(format!("fiatlux-fuzz-{name}-{}", std::process::id()));
    let _ = fs::remove_dir_all(&folder);
    fs::create_dir_all(&folder).expect("a folder");
    folder
}

/// Where `run.sh` asks for seeds in place of a run: their folder, and a bag to make them of.
pub fn seeds_wanted() -> Option<(PathBuf, PathBuf)> {
    let [folder, bag] =
        ["FIATLUX_FUZZ_SEEDS", "FIATLUX_FUZZ_BAG"].map(|name| std::env::var_os(name).map(PathBuf::from));
    folder.zip(bag)
}

/// Writes seeds and ends the process.
pub fn write_seeds(folder: &Path, seeds: impl IntoIterator<Item = (String, Vec<u8>)>) -> ! {
    for (name, bytes) in seeds {
        fs::write(folder.join(name), bytes).expect("a seed");
    }
    std::process::exit(0)
}

pub fn put(out: &mut Vec<u8>, kind: u8, bytes: &[u8]) {
    out.push(kind);
    out.extend((bytes.len() as u32).to_le_bytes());
    out.extend(bytes);
}

/// The messages in some bytes, as far as they go.
pub fn parts(mut bytes: &[u8]) -> impl Iterator<Item = (u8, &[u8])> {
    std::iter::from_fn(move || {
        let (kind, rest) = bytes.split_first()?;
        let (length, rest) = rest.split_first_chunk::<4>()?;
        let (part, rest) = rest.split_at_checked(u32::from_le_bytes(*length) as usize)?;
        bytes = rest;
        Some((*kind, part))
    })
}

/// The first rows of a bag, in parts.
pub fn take_apart(bag: &Path) -> Vec<u8> {
    let bag = Bag::open(bag).expect("a bag");
    let mut out = Vec::new();
    put(&mut out, HEADER, &bag.header().encode_to_vec());
    let mut rows = 0;
    let mut add = |kind, message: Vec<u8>| put(&mut out, kind, &message);
    for (state, action) in bag.states().zip(bag.actions()).take(SEED_ROWS) {
        add(0, state.expect("a row").encode_to_vec());
        add(1, action.expect("an action").encode_to_vec());
        rows += 1;
    }
    bag.events().take(SEED_ROWS).for_each(|event| add(2, event.expect("an event").encode_to_vec()));
    bag.observations().take(1).for_each(|seen| add(3, seen.expect("an observation").encode_to_vec()));
    bag.rewards().take(1).for_each(|reward| add(4, reward.expect("a reward").encode_to_vec()));
    let mut result = bag.result().expect("a whole bag").clone();
    result.signature = None;
    if let Some(end) = &mut result.end {
        end.steps = rows - 1;
    }
    put(&mut out, RESULT, &result.encode_to_vec());
    out
}

/// Writes a bag of such parts; `None` where they make none.
pub fn put_together(bytes: &[u8], path: &Path) -> Option<()> {
    let header = parts(bytes).find(|(kind, _)| *kind == HEADER)?.1;
    let mut header = EpisodeHeader::decode(header).ok()?;
    let result = parts(bytes).find(|(kind, _)| *kind == RESULT).map_or(&[][..], |(_, result)| result);
    let mut result = EpisodeResult::decode(result).ok()?;
    seal(bytes, &mut header, &mut result);
    let mut writer = BagWriter::create(path, &header).ok()?;
    let mut step = 0;
    for (kind, part) in parts(bytes) {
        let Some(topic) = TOPICS.get(usize::from(kind)) else { continue };
        if *topic == topic::STATE {
            step = State::decode(part).map_or(step, |state| state.step);
        }
        writer.message(topic, step, part).ok()?;
    }
    writer.finish(&result).ok().map(drop)
}

/// Makes all digests fit the present content, as far as it can be read.
fn seal(bytes: &[u8], header: &mut EpisodeHeader, result: &mut EpisodeResult) {
    if let (Ok(identity), Ok(layout)) = (read_identity(header), layout_of(header)) {
        let mut digest = identity.digest();
        header.digest_context = digest.hex();
        let rows = parts(bytes).filter(|(kind, _)| *kind == 0).filter_map(|(_, row)| State::decode(row).ok());
        rows.filter_map(|row| read_row(&row, layout).ok()).for_each(|row| digest.push(&row));
        if let Some(end) = &mut result.end {
            end.digest = digest.hex();
        }
    }
    result.header_digest = header_digest(header);
}

/// A time between two inputs, from one byte: up to 25 s.
pub fn pause(byte: u8) -> Duration {
    Duration::from_millis(u64::from(byte) * 100)
}
