//! Finds a file's records by their lengths, without unpacking a chunk.

use std::collections::BTreeMap;
use std::io::{BufReader, Read};
use std::path::Path;

use mcap::MAGIC;
use mcap::records::op;

use fiatlux_proto::plain;

use crate::channels::{Channels, MAX_CHANNELS};
use crate::take::{take, take_bytes, take_map, take_text, take_u16, take_u64};
use crate::writer::LIBRARY;
use crate::{BagError, metadata};

/// Maximum size of a record that is read, apart from chunks, bytes. A header takes about 10,000.
const MAX_RECORD: u64 = 1 << 20;

/// Maximum number of chunks. An errand of 72,000 rows has about 1,200.
const MAX_CHUNKS: usize = 1 << 16;

/// Operation code and length.
const HEAD: u64 = 9;

/// Bytes of a zstd chunk before its data.
const CHUNK_HEAD: u64 = 8 + 8 + 8 + 4 + 4 + 4 + 8;

/// Bytes of the statistics before the number of chunks, their last field.
const STATISTICS_HEAD: u64 = 8 + 2 + 4 + 4 + 4 + 4;

/// Bytes of a footer; its checksum is last.
const FOOTER: u64 = 8 + 8 + 4;

/// Maximum size of a chunk that is unpacked, bytes.
pub(crate) const MAX_CHUNK: u64 = 32 << 20;

/// All chunks of a file may unpack to this many bytes, ...
const FREE_UNPACKED: u64 = 32 << 20;

/// ... and for each byte of the file this many more (a recorder's bags have 3 to 5, their smallest chunks 11), ...
const MAX_RATIO: u64 = 32;

/// ... but never more than this. An errand of 72,000 rows with all sensors takes about 6 GiB.
const MAX_UNPACKED: u64 = 16 << 30;

#[derive(Debug, Clone)]
pub(crate) struct ChunkAt {
    pub offset: u64,
    /// With operation code and length, bytes.
    pub length: u64,
    /// Latest log time in it, ns.
    pub end_time: u64,
    /// Channels of its messages, from its indexes; `None` if they are incomplete, or the summary's differ.
    pub channels: Option<Vec<u16>>,
}

impl ChunkAt {
    /// False only if the chunk is known to have no message of the topic.
    pub fn may_have(&self, topic: &str, channels: &Channels) -> bool {
        let is_other = |id: &u16| channels.topic(*id).is_some_and(|known| known != topic);
        self.channels.as_ref().is_none_or(|ids| !ids.iter().all(is_other))
    }
}

/// Positions and values of a file's checksums.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Sums {
    /// First byte after the data section, and the checksum over all before it; 0 if the writer made none.
    pub data: Option<(u64, u32)>,
    /// First byte of the summary, the first byte after the checksummed part, and the checksum; 0 as above.
    pub summary: Option<(u64, u64, u32)>,
    /// Our own writer made the file: it always writes checksums.
    pub is_ours: bool,
}

#[derive(Debug, Default)]
pub(crate) struct Scan {
    pub sums: Sums,
    pub header: Option<BTreeMap<String, String>>,
    pub result: Option<BTreeMap<String, String>>,
    pub cut: Option<BTreeMap<String, String>>,
    pub thin: Option<BTreeMap<String, String>>,
    pub chunks: Vec<ChunkAt>,
    pub channels: Channels,
    /// Offset and reason if the scan ended before the file's proper end.
    pub broken: Option<(u64, String)>,
    /// The reason why a record was refused; `None` if it cannot be read.
    why: Option<String>,
    /// Sum over the chunks, from their heads, bytes.
    unpacked: u64,
}

/// Reads a file's records up to its end or to the first incomplete one.
pub(crate) fn scan(path: &Path) -> Result<Scan, BagError> {
    let file = fiatlux_files::open(path).map_err(BagError::io("open", path))?;
    let size = file.metadata().map_err(BagError::io("read", path))?.len();
    let mut reader = BufReader::new(file);
    let mut scan = Scan::default();
    let magic = read(&mut reader, (MAGIC.len() as u64).min(size)).map_err(BagError::io("read", path))?;
    if magic != MAGIC {
        return Err(BagError::not_a_bag(path, "it does not start as an MCAP file does"));
    }
    let mut at = MAGIC.len() as u64;
    loop {
        let cut = |what: &str| Some((at, format!("the file ends at byte {size}, {what}")));
        if size - at < HEAD {
            scan.broken = cut("before its summary's end");
            break;
        }
        let head = read(&mut reader, HEAD).map_err(BagError::io("read", path))?;
        let (opcode, length) = (head[0], take_u64(&mut &head[1..]).unwrap_or(u64::MAX));
        if !(op::HEADER..=op::DATA_END).contains(&opcode) && opcode < 0x80 {
            scan.broken = Some((at, format!("byte {at} starts no record")));
            break;
        }
        if length > size - at - HEAD {
            scan.broken = cut("in a record");
            break;
        }
        let wanted = match opcode {
            op::CHUNK => CHUNK_HEAD.min(length),
            op::MESSAGE_INDEX => 2,
            op::HEADER | op::METADATA | op::CHANNEL | op::CHUNK_INDEX => length,
            op::DATA_END => 4,
            op::FOOTER => FOOTER,
            op::STATISTICS => STATISTICS_HEAD.min(length),
            _ => 0,
        };
        if wanted > length || wanted > MAX_RECORD {
            scan.broken = Some((at, format!("the record at byte {at} has an impossible length")));
            break;
        }
        let body = read(&mut reader, wanted).map_err(BagError::io("read", path))?;
        let known = scan.record(opcode, at, HEAD + length, &body);
        if known.is_none() {
            let what = scan.why.take().unwrap_or_else(|| "cannot be read".into());
            scan.broken = Some((at, format!("the record at byte {at} {what}")));
            break;
        }
        // Lengths are at most the file's size.
        reader.seek_relative((length - wanted) as i64).map_err(BagError::io("read", path))?;
        at += HEAD + length;
        if opcode == op::FOOTER {
            let end = read(&mut reader, (size - at).min(MAGIC.len() as u64 + 1)).map_err(BagError::io("read", path))?;
            if end.len() < MAGIC.len() {
                scan.broken = Some((at, format!("the file ends at byte {size}, before its end mark")));
            } else if end != MAGIC {
                scan.broken = Some((at, format!("byte {at} is not the end of an MCAP file")));
            }
            break;
        }
    }
    let most = size.saturating_mul(MAX_RATIO).saturating_add(FREE_UNPACKED).min(MAX_UNPACKED);
    if scan.unpacked > most {
        let unpacked = scan.unpacked;
        return Err(BagError::not_a_bag(
            path,
            format!("its {size} bytes unpack to {unpacked}; a file of this size may unpack to {most}"),
        ));
    }
    if let (Some(_), Some(last)) = (&scan.broken, scan.chunks.last_mut()) {
        // Some of its indexes may be lost.
        if last.offset + last.length == at || last.channels.is_some() {
            last.channels = None;
        }
    }
    Ok(scan)
}

impl Scan {
    fn record(&mut self, opcode: u8, offset: u64, length: u64, mut body: &[u8]) -> Option<()> {
        match opcode {
            op::HEADER => {
                let (_profile, library) = (take_text(&mut body)?, take_text(&mut body)?);
                self.sums.is_ours = library.starts_with(LIBRARY);
            }
            op::DATA_END => self.sums.data = Some((offset, u32::from_le_bytes(take(&mut body)?))),
            op::FOOTER => {
                let (start, _offsets) = (take_u64(&mut body)?, take_u64(&mut body)?);
                let is_after_data = self.sums.data.is_some_and(|(end, _)| (end + HEAD..=offset).contains(&start));
                if start != 0 && !is_after_data {
                    return self
                        .refuse(format!("is a footer that puts the summary at byte {start}, where none can be"));
                }
                self.sums.summary = Some((start, offset + HEAD + FOOTER - 4, u32::from_le_bytes(take(&mut body)?)));
            }
            op::CHUNK => {
                let (_start_time, end_time) = (take_u64(&mut body)?, take_u64(&mut body)?);
                let (unpacked, _crc) = (take_u64(&mut body)?, take::<4>(&mut body)?);
                let (compression, packed) = (take_text(&mut body)?, take_u64(&mut body)?);
                if compression != "zstd" {
                    let how = if compression.is_empty() {
                        "not at all".into()
                    } else {
                        format!("by '{}'", plain(&compression))
                    };
                    return self.refuse(format!("is a chunk that is compressed {how}; a recorder compresses by zstd"));
                }
                let fits = packed.checked_add(CHUNK_HEAD + HEAD) == Some(length) && packed.max(unpacked) <= MAX_CHUNK;
                if !fits || self.chunks.len() >= MAX_CHUNKS {
                    return None;
                }
                self.unpacked += unpacked;
                self.chunks.push(ChunkAt { offset, length, end_time, channels: Some(Vec::new()) });
            }
            op::MESSAGE_INDEX => {
                let channel = take_u16(&mut body)?;
                let last = self.chunks.last_mut()?;
                if let Some(channels) = &mut last.channels
                    && !channels.contains(&channel)
                {
                    channels.push(channel);
                }
                if last.channels.as_ref().is_some_and(|channels| channels.len() > MAX_CHANNELS) {
                    last.channels = None;
                }
            }
            op::METADATA => {
                let name = take_text(&mut body)?;
                let record = match name.as_str() {
                    metadata::HEADER => &mut self.header,
                    metadata::RESULT => &mut self.result,
                    metadata::CUT => &mut self.cut,
                    metadata::THIN => &mut self.thin,
                    _ => return Some(()),
                };
                if record.is_some() {
                    // Other readers may use the other copy.
                    return self.refuse("repeats an earlier one");
                }
                *record = Some(take_map(&mut body)?);
            }
            op::CHANNEL => self.channels.add(body)?,
            // No checksum covers the indexes between chunks: a damaged index, or a chunk that no longer looks like one,
            // would hide messages. The summary repeats the indexes.
            op::CHUNK_INDEX => {
                let (_start, _end, at) = (take_u64(&mut body)?, take_u64(&mut body)?, take_u64(&mut body)?);
                let (_length, mut indexes) = (take_u64(&mut body)?, take_bytes(&mut body)?);
                let chunk = self.chunks.binary_search_by_key(&at, |chunk| chunk.offset).ok()?;
                let chunk = &mut self.chunks[chunk];
                let mut channels = Vec::new();
                while !indexes.is_empty() && channels.len() <= MAX_CHANNELS {
                    channels.push(take_u16(&mut indexes)?);
                    let _offset = take_u64(&mut indexes)?;
                }
                let agrees = |known: &Vec<u16>| {
                    known.len() == channels.len() && known.iter().all(|channel| channels.contains(channel))
                };
                chunk.channels = chunk.channels.take().filter(agrees);
            }
            op::STATISTICS => {
                let (_messages, _schemas, _others) =
                    (take_u64(&mut body)?, take_u16(&mut body)?, take::<12>(&mut body)?);
                let chunks = u32::from_le_bytes(take(&mut body)?);
                (chunks as usize == self.chunks.len()).then_some(())?;
            }
            _ => {}
        }
        Some(())
    }

    /// Ends the scan at this record.
    fn refuse(&mut self, why: impl Into<String>) -> Option<()> {
        self.why = Some(why.into());
        None
    }
}

fn read(reader: &mut impl Read, length: u64) -> std::io::Result<Vec<u8>> {
    let mut bytes = vec![0; length as usize];
    reader.read_exact(&mut bytes)?;
    Ok(bytes)
}
