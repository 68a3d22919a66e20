use std::collections::BTreeMap;
use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{BufWriter, Cursor, Read, Seek, Write};
use std::path::{Path, PathBuf};

use fiatlux_proto::Message;
use fiatlux_proto::v3::{EpisodeHeader, EpisodeResult, StepRecord};
use mcap::records::{MessageHeader, Metadata};
use mcap::{Compression, WriteOptions};

use crate::BagError;
use crate::metadata;
use crate::topic::{self, TOPICS};

/// Rows of a chunk. Only their number ends it, so that the same episode gives the same bytes.
pub const ROWS_PER_CHUNK: u64 = 128;

/// Actions of a chunk of a thin bag.
const ACTIONS_PER_CHUNK: u64 = 8192;

/// A chunk ends early when it would grow beyond this, bytes.
const MAX_GROUP: usize = 8 << 20;

/// zstd, which reads the bits as a signed number. Of 6,000 rows, level 1 takes 1.8 times as long for 5 % less, level 3 4.4 times for
/// 8 % less.
const LEVEL: u32 = (-3_i32).cast_unsigned();

/// zstd for thin bags, which are small.
const THIN_LEVEL: u32 = 9;

/// Takes everything up to the first row, and chunks of some rows.
const BUFFER: usize = 256 << 10;

/// The writing library, as the file's first record names it.
pub(crate) const LIBRARY: &str = "fiatlux";

/// Length of a step, ns.
pub(crate) const STEP_NS: u64 = 20_000_000;

/// Writes one bag. Its file is named `NAME.mcap.part` until it is finished; dropped before, it stays so, and
/// [`BagWriter::resume`] goes on with it.
pub struct BagWriter {
    path: PathBuf,
    part: PathBuf,
    /// `Some` until the writer ends.
    mcap: Option<mcap::Writer<BufWriter<File>>>,
    graded: Group,
    other: Group,
    thin: bool,
    next_step: u64,
    next_step_on_disk: u64,
}

#[derive(Default)]
struct Group {
    bytes: Vec<u8>,
    /// Channel, step, end in `bytes`.
    messages: Vec<(u16, u64, usize)>,
}

impl Group {
    fn push(&mut self, channel: u16, step: u64, bytes: &[u8]) {
        self.bytes.extend_from_slice(bytes);
        self.messages.push((channel, step, self.bytes.len()));
    }

    fn clear(&mut self) {
        self.bytes.clear();
        self.messages.clear();
    }
}

impl BagWriter {
    /// Starts the bag `path` (`NAME.mcap`) as `NAME.mcap.part`; makes its folder. A part that ends before the first row
    /// is replaced: its recorder died there.
    pub fn create(path: &Path, header: &EpisodeHeader) -> Result<Self, BagError> {
        let part = part_of(path);
        if path.exists() {
            return Err(BagError::Exists { path: path.into() });
        }
        if let Some(folder) = path.parent() {
            fs::create_dir_all(folder).map_err(BagError::io("make the folder", folder))?;
        }
        let file = OpenOptions::new().read(true).write(true).create(true).truncate(false).open(&part);
        let file = file.map_err(BagError::io("make", &part))?;
        // The lock distinguishes an abandoned part from one that is being written.
        let is_written = matches!(file.try_lock(), Err(TryLockError::WouldBlock));
        if is_written || !is_only_begun(&file, &part, header)? {
            return Err(BagError::Exists { path: part });
        }
        Self::start(path, part, file, header, false)
    }

    /// Writes a file named `part` from its first byte; `thin` if it gets no rows.
    pub(crate) fn start(
        path: &Path,
        part: PathBuf,
        file: File,
        header: &EpisodeHeader,
        thin: bool,
    ) -> Result<Self, BagError> {
        let mcap = begin(BufWriter::with_capacity(BUFFER, file), &part, header, thin)?;
        Ok(Self {
            path: path.into(),
            part,
            mcap: Some(mcap),
            graded: Group::default(),
            other: Group::default(),
            thin,
            next_step: 0,
            next_step_on_disk: 0,
        })
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The step after the last pushed row.
    pub fn next_step(&self) -> u64 {
        self.next_step
    }

    /// The step after the last row that was handed to the operating system.
    pub fn next_step_on_disk(&self) -> u64 {
        self.next_step_on_disk
    }

    /// Adds the nested messages of a row byte for byte, the scene among them; header and result are left out. After
    /// every [`ROWS_PER_CHUNK`] rows the chunk goes to the operating system.
    pub fn push(&mut self, truth: &StepRecord) -> Result<(), BagError> {
        let step = truth.step;
        let other = [
            (topic::SCENE, &truth.scene),
            (topic::ACTION, &truth.action),
            (topic::OBSERVATION, &truth.observation),
            (topic::REWARD, &truth.reward),
            (topic::CAMERA, &truth.camera),
            (topic::LIDAR, &truth.lidar),
        ];
        for (topic, bytes) in other {
            if !bytes.is_empty() {
                self.message(topic, step, bytes)?;
            }
        }
        for event in &truth.events {
            self.message(topic::EVENT, step, event)?;
        }
        if !truth.state.is_empty() {
            self.message(topic::STATE, step, &truth.state)?;
        }
        Ok(())
    }

    /// Adds one message. Those of a step come before its `/state`, which ends the row; in a thin bag its `/action` does.
    pub fn message(&mut self, topic: &str, step: u64, bytes: &[u8]) -> Result<(), BagError> {
        let channel = topic::channel(topic).ok_or_else(|| BagError::Topic { topic: topic.into() })?;
        let group = if topic::is_graded(topic) { &mut self.graded } else { &mut self.other };
        group.push(channel, step, bytes);
        let (last, count) = match self.thin {
            true => (topic::ACTION, ACTIONS_PER_CHUNK),
            false => (topic::STATE, ROWS_PER_CHUNK),
        };
        if topic == last {
            self.next_step = step.saturating_add(1);
            let full = self.next_step.is_multiple_of(count);
            if full || self.graded.bytes.len().max(self.other.bytes.len()) > MAX_GROUP {
                self.flush()?;
            }
        }
        Ok(())
    }

    /// Ends the chunk and hands it to the operating system. A bag with extra flushes is not byte for byte the one
    /// without them.
    pub fn flush(&mut self) -> Result<(), BagError> {
        let Some(mcap) = &mut self.mcap else { return Ok(()) };
        for group in [&mut self.other, &mut self.graded] {
            let mut start = 0;
            for &(channel_id, step, end) in &group.messages {
                let time = step.saturating_mul(STEP_NS);
                let sequence = step.try_into().unwrap_or(u32::MAX);
                let header = MessageHeader { channel_id, sequence, log_time: time, publish_time: time };
                mcap.write_to_known_channel(&header, &group.bytes[start..end]).map_err(BagError::write(&self.part))?;
                start = end;
            }
            mcap.flush().map_err(BagError::write(&self.part))?;
            group.clear();
        }
        self.next_step_on_disk = self.next_step;
        Ok(())
    }

    /// Ends the bag with the episode's result and gives it its name.
    pub fn finish(mut self, result: &EpisodeResult) -> Result<PathBuf, BagError> {
        let fields = metadata::fields(result).ok_or(BagError::Values { what: "result" })?;
        self.message(topic::RESULT, result.end.as_ref().map_or(0, |end| end.steps), &result.encode_to_vec())?;
        self.end(metadata::RESULT, fields)
    }

    /// Ends a bag whose episode could not be recorded to its end.
    pub fn finish_cut(self, reason: &str) -> Result<PathBuf, BagError> {
        let next_step = self.next_step.to_string();
        let fields = BTreeMap::from([("reason".to_owned(), reason.to_owned()), ("next_step".to_owned(), next_step)]);
        self.end(metadata::CUT, fields)
    }

    fn end(mut self, name: &str, fields: BTreeMap<String, String>) -> Result<PathBuf, BagError> {
        self.flush()?;
        if let Some(mut mcap) = self.mcap.take() {
            let metadata = Metadata { name: name.into(), metadata: fields };
            mcap.write_metadata(&metadata).map_err(BagError::write(&self.part))?;
            mcap.finish().map_err(BagError::write(&self.part))?;
            mcap.into_inner().flush().map_err(BagError::io("write", &self.part))?;
        }
        if self.path.exists() {
            return Err(BagError::Exists { path: self.path.clone() });
        }
        fs::rename(&self.part, &self.path).map_err(BagError::io("rename", &self.part))?;
        Ok(self.path.clone())
    }

    /// Drops the messages of a row without a state.
    pub(crate) fn forget_row(&mut self) {
        for group in [&mut self.graded, &mut self.other] {
            let whole = group.messages.iter().take_while(|(_, step, _)| *step < self.next_step).count();
            group.messages.truncate(whole);
            group.bytes.truncate(group.messages.last().map_or(0, |(_, _, end)| *end));
        }
    }

    /// Names the file that is being written `NAME.mcap.part`.
    pub(crate) fn rename_part(&mut self, part: PathBuf) -> Result<(), BagError> {
        fs::rename(&self.part, &part).map_err(BagError::io("rename", &self.part))?;
        self.part = part;
        Ok(())
    }
}

impl Drop for BagWriter {
    fn drop(&mut self) {
        // The MCAP writer would add a summary to a bag that is not whole.
        if let Some(mcap) = self.mcap.take() {
            drop(mcap.into_inner());
        }
    }
}

/// Writes all that comes before the first row.
fn begin<W: Write + Seek>(
    into: W,
    part: &Path,
    header: &EpisodeHeader,
    thin: bool,
) -> Result<mcap::Writer<W>, BagError> {
    let fields = metadata::fields(header).ok_or(BagError::Values { what: "header" })?;
    let failed = |source| BagError::Write { path: part.into(), source: Box::new(source) };
    let options = WriteOptions::new()
        .profile("fiatlux")
        .library(format!("{LIBRARY} 1"))
        .chunk_size(None)
        .calculate_data_section_crc(true)
        .calculate_summary_section_crc(true)
        // Only whole chunks reach the file.
        .disable_seeking(true)
        .compression(Some(Compression::Zstd))
        .compression_level(if thin { THIN_LEVEL } else { LEVEL })
        .compression_threads(0);
    let mut mcap = options.create(into).map_err(failed)?;
    mcap.write_metadata(&Metadata { name: metadata::HEADER.into(), metadata: fields }).map_err(failed)?;
    if thin {
        let kept = BTreeMap::from([("topics".to_owned(), [topic::ACTION, topic::RESULT].join(" "))]);
        mcap.write_metadata(&Metadata { name: metadata::THIN.into(), metadata: kept }).map_err(failed)?;
    }
    // The first chunk has all schemas and channels, so that a reader can skip any other.
    for (index, (topic, message)) in TOPICS.into_iter().enumerate() {
        let schema = mcap.add_schema(message, "protobuf", &topic::schema(message)).map_err(failed)?;
        let id = index as u16 + 1;
        mcap.add_channel_with_id(id, schema, topic, "protobuf", &BTreeMap::new()).map_err(failed)?;
    }
    mcap.flush().map_err(failed)?;
    Ok(mcap)
}

/// True if a file has nothing but the beginning of what comes before the first row.
fn is_only_begun(mut file: &File, part: &Path, header: &EpisodeHeader) -> Result<bool, BagError> {
    let length = file.metadata().map_err(BagError::io("read", part))?.len();
    if length == 0 {
        return Ok(true);
    }
    let whole = begin(Cursor::new(Vec::new()), part, header, false)?.into_inner().into_inner();
    if length >= whole.len() as u64 {
        return Ok(false);
    }
    let mut found = Vec::new();
    file.read_to_end(&mut found).and_then(|_| file.rewind()).map_err(BagError::io("read", part))?;
    Ok(whole.starts_with(&found))
}

/// Name of a bag while it is written: `NAME.mcap.part`.
pub fn part_of(path: &Path) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(".part");
    name.into()
}
