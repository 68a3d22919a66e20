//! The messages of a bag's chunks, one chunk in memory at a time.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::slice;

use crc32fast::Hasher;
use fiatlux_proto::limits::MAX_SERVER_MESSAGE;
use fiatlux_proto::v3::State;
use fiatlux_proto::{Message, decode_onto};
use mcap::records::op;
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use prost::Name;

use crate::channels::Channels;
use crate::scan::{ChunkAt, MAX_CHUNK};
use crate::take::{take_u16, take_u64};
use crate::writer::STEP_NS;
use crate::{BagError, Patience, topic};

pub(crate) struct FoundMessage<'a> {
    pub channel: u16,
    pub topic: &'a str,
    pub step: u64,
    pub bytes: &'a [u8],
}

/// The parts of a bag that have been read, so that [`Bag::check_rest`](crate::Bag::check_rest) need not read them
/// again.
#[derive(Debug, Clone, Default)]
pub struct ReadParts {
    /// Checksums of the records of whole chunks, by offset.
    pub(crate) chunks: BTreeMap<u64, Hasher>,
    /// Messages on `/result`, with the offset of their chunk.
    pub(crate) results: Vec<(u64, Vec<u8>)>,
}

/// Walks through one chunk after the other.
pub(crate) struct ChunkReader {
    path: PathBuf,
    file: File,
    reader: LinearReader,
    at_end: bool,
    offset: u64,
    /// Bytes of the chunk record that are not read yet.
    remaining: u64,
    /// Of the bytes read so far.
    hasher: Hasher,
    pub seen: ReadParts,
    pub channels: Channels,
    patience: Option<Patience>,
}

fn new_reader() -> LinearReader {
    let options = LinearReaderOptions::default().with_skip_start_magic(true).with_skip_end_magic(true);
    // A checksum is compared before any message of its chunk is given out.
    let options = options.with_prevalidate_chunk_crcs(true);
    LinearReader::new_with_options(options.with_record_length_limit(MAX_CHUNK as usize))
}

impl ChunkReader {
    pub fn open(path: &Path, channels: Channels, patience: Option<Patience>) -> Result<Self, BagError> {
        let file = fiatlux_files::open(path).map_err(BagError::io("open", path))?;
        let (path, reader, hasher, seen) = (path.into(), new_reader(), Hasher::new(), ReadParts::default());
        Ok(Self { path, file, reader, at_end: true, offset: 0, remaining: 0, hasher, seen, channels, patience })
    }

    pub fn start(&mut self, chunk: &ChunkAt) -> Result<(), BagError> {
        self.file.seek(SeekFrom::Start(chunk.offset)).map_err(BagError::io("read", &self.path))?;
        if !self.at_end {
            self.reader = new_reader();
            self.at_end = true;
        }
        (self.offset, self.remaining, self.hasher) = (chunk.offset, chunk.length, Hasher::new());
        Ok(())
    }

    /// Passes messages to `look` until it takes one; `None` at the chunk's end.
    pub fn find<T>(
        &mut self,
        mut look: impl FnMut(FoundMessage<'_>) -> Result<Option<T>, BagError>,
    ) -> Result<Option<T>, BagError> {
        let Self { path, file, reader, at_end, offset, remaining, hasher, seen, channels, patience } = self;
        let damaged = |reason: &str| BagError::damaged(path, *offset, reason);
        loop {
            if patience.as_ref().is_some_and(|patience| !patience.goes_on()) {
                *at_end = false;
                return Err(BagError::Slow { path: path.clone() });
            }
            match reader.next_event() {
                None => return Ok(None),
                Some(Err(error)) => {
                    (*at_end, *remaining) = (false, 0);
                    return Err(damaged(&error.to_string()));
                }
                Some(Ok(LinearReadEvent::ReadRequest(hint))) => {
                    *at_end = *remaining == 0;
                    if *at_end {
                        seen.chunks.insert(*offset, hasher.clone());
                        return Ok(None);
                    }
                    let wanted = (hint as u64).clamp(1, *remaining) as usize;
                    let buffer = reader.insert(wanted);
                    let read = file.read(buffer).map_err(BagError::io("read", path))?;
                    hasher.update(&buffer[..read]);
                    if read == 0 {
                        *remaining = 0;
                        return Err(damaged("the file became shorter"));
                    }
                    reader.notify_read(read);
                    *remaining -= read as u64;
                }
                Some(Ok(LinearReadEvent::Record { opcode: op::MESSAGE, data })) => {
                    let (channel, step, bytes) = message(data).ok_or_else(|| damaged("a message without a head"))?;
                    let topic = channels.topic(channel).ok_or_else(|| damaged("a message without a channel"))?;
                    if let Some(why) = channels.refusal(channel) {
                        return Err(damaged(&why));
                    }
                    // Two are already an error.
                    if topic == topic::RESULT && seen.results.len() < 2 {
                        seen.results.push((*offset, bytes.to_vec()));
                    }
                    if let Some(taken) = look(FoundMessage { channel, topic, step, bytes })? {
                        return Ok(Some(taken));
                    }
                }
                Some(Ok(LinearReadEvent::Record { opcode: op::CHANNEL, data })) => {
                    channels.add(data).ok_or_else(|| damaged("a channel that cannot be read"))?;
                }
                Some(Ok(LinearReadEvent::Record { .. })) => {}
            }
        }
    }
}

/// Channel, step and data of a message record.
fn message(mut record: &[u8]) -> Option<(u16, u64, &[u8])> {
    let channel = take_u16(&mut record)?;
    let (_sequence, log_time) = (record.split_off(..4)?, take_u64(&mut record)?);
    let _publish_time = take_u64(&mut record)?;
    Some((channel, log_time / STEP_NS, record))
}

/// The messages of a topic, in the file's order; an error ends them.
pub struct Messages<'a, M> {
    path: &'a Path,
    chunks: slice::Iter<'a, ChunkAt>,
    topic: &'static str,
    /// `None` at the end.
    reader: Option<ChunkReader>,
    seen: ReadParts,
    /// Returned by the next call in place of a message.
    error: Option<BagError>,
    /// The next message is read onto this one.
    empty: M,
}

impl<'a, M: Message + Name + Default> Messages<'a, M> {
    pub(crate) fn new(
        path: &'a Path,
        chunks: &'a [ChunkAt],
        reader: Result<ChunkReader, BagError>,
        topic: &'static str,
    ) -> Self {
        let (reader, error) = match reader {
            Ok(reader) => (Some(reader), None),
            Err(error) => (None, Some(error)),
        };
        Self { path, chunks: chunks.iter(), topic, reader, seen: ReadParts::default(), error, empty: M::default() }
    }

    pub fn into_read(self) -> ReadParts {
        self.reader.map_or(self.seen, |reader| reader.seen)
    }

    fn read(&mut self) -> Result<Option<M>, BagError> {
        let Some(reader) = &mut self.reader else { return Ok(None) };
        let (path, topic, empty) = (self.path, self.topic, &mut self.empty);
        loop {
            let found = reader.find(|found| {
                if found.topic != topic {
                    return Ok(None);
                }
                let step = found.step;
                let wrong = |source| BagError::Message { path: path.into(), topic, step, source };
                decode_onto(std::mem::take(empty), found.bytes, MAX_SERVER_MESSAGE).map(Some).map_err(wrong)
            })?;
            if found.is_some() {
                return Ok(found);
            }
            let may_have = |chunk: &&ChunkAt| chunk.may_have(topic, &reader.channels);
            let Some(chunk) = self.chunks.find(may_have) else { return Ok(None) };
            reader.start(chunk)?;
        }
    }
}

impl Messages<'_, State> {
    /// Reuses the lists of a state that was read, which saves most of the work of reading the next one.
    pub fn reuse(&mut self, state: State) {
        let list = |mut list: Vec<f64>| {
            list.clear();
            list
        };
        self.empty = State {
            joint_position: list(state.joint_position),
            joint_velocity: list(state.joint_velocity),
            joint_target: list(state.joint_target),
            joint_effort: list(state.joint_effort),
            action: list(state.action),
            forces: list(state.forces),
            loads: list(state.loads),
            ..State::default()
        };
    }
}

impl<M: Message + Name + Default> Iterator for Messages<'_, M> {
    type Item = Result<M, BagError>;

    fn next(&mut self) -> Option<Self::Item> {
        if let Some(error) = self.error.take() {
            return Some(Err(error));
        }
        let read = self.read().transpose();
        if !matches!(read, Some(Ok(_)))
            && let Some(reader) = self.reader.take()
        {
            self.seen = reader.seen;
        }
        read
    }
}
