//! Compares a bag's bytes with its checksums.

use std::fs::File;
use std::io::{Read, Seek, SeekFrom};

use crc32fast::Hasher;
use fiatlux_proto::limits::MAX_SERVER_MESSAGE;
use fiatlux_proto::v3::EpisodeResult;
use fiatlux_proto::{PROTOCOL, decode};

use crate::scan::{ChunkAt, Sums};
use crate::stream::ReadParts;
use crate::{Bag, BagError, Completeness, topic};

const BLOCK: usize = 1 << 20;

impl Bag {
    /// Reads the whole file, compares it with its checksums, and compares two copies of the same data with each other:
    /// a bit that has changed anywhere is found. [`Bag::open`] reads only the first chunk; the others are checked when
    /// their messages are read.
    ///
    /// Checksums find accidents. They do not find deliberate changes: anybody can compute them anew.
    ///
    /// # Errors
    /// [`BagError::Damaged`]: a checksum differs, or is missing where our own writer made the file.
    /// [`BagError::Disagrees`]: the result in the metadata is not the one on `/result`, or the header has a field of no
    /// version up to this one.
    pub fn check(&self) -> Result<(), BagError> {
        self.check_rest(&ReadParts::default())
    }

    /// [`Bag::check`] after messages have been read: their chunks are not read again. Grading reads two thirds of the
    /// file.
    pub fn check_rest(&self, seen: &ReadParts) -> Result<(), BagError> {
        // The rows that were read are not in this file.
        let nothing = ReadParts::default();
        let seen = if self.is_thin() { &nothing } else { seen };
        let Sums { data, summary, is_ours } = self.sums;
        let whole = *self.completeness() == Completeness::Whole;
        let mut file = fiatlux_files::open(self.path()).map_err(BagError::io("open", self.path()))?;
        let mut covered = |what: &str, from: u64, to: u64, sum: u32| {
            if sum == 0 && !is_ours {
                // The format leaves checksums to the writer.
                return Ok(());
            }
            let found = self.checksum(&mut file, from, to, seen).map_err(BagError::io("read", self.path()))?;
            let reason = || format!("the checksum of its {what} is {sum:08x}, its bytes have {found:08x}");
            if found == sum { Ok(()) } else { Err(BagError::damaged(self.path(), from, reason())) }
        };
        match (data, summary) {
            (Some((end, data)), Some((start, summary_end, summary))) => {
                covered("data section", 0, end, data)?;
                if start > 0 {
                    covered("summary", start, summary_end, summary)?;
                }
            }
            _ if whole => return Err(BagError::damaged(self.path(), 0, "its data section or its summary has no end")),
            // A bag that was not finished has neither, and says so.
            _ => {}
        }
        if whole { self.check_doubles(seen) } else { Ok(()) }
    }

    /// Checksum over bytes of the file; of chunks that were seen, without reading them again.
    fn checksum(&self, file: &mut File, from: u64, to: u64, seen: &ReadParts) -> std::io::Result<u32> {
        let (mut hasher, mut at) = (Hasher::new(), from);
        let mut block = vec![0; BLOCK.min(to.saturating_sub(from) as usize)];
        for ChunkAt { offset, length, .. } in self.chunks() {
            let end = offset + length;
            if let Some(chunk) = seen.chunks.get(offset).filter(|_| *offset >= at && end <= to) {
                add(&mut hasher, file, at, *offset, &mut block)?;
                hasher.combine(chunk);
                at = end;
            }
        }
        add(&mut hasher, file, at, to, &mut block)?;
        Ok(hasher.finalize())
    }

    fn check_doubles(&self, seen: &ReadParts) -> Result<(), BagError> {
        let disagrees = |what: String| BagError::Disagrees { path: self.path().into(), what };
        let is_newer = self.header().protocol.is_some_and(|protocol| protocol.minor > PROTOCOL.minor);
        if let (Some(field), false) = (&self.unknown_field, is_newer) {
            return Err(disagrees(format!("its header has a field '{field}', which this protocol does not define")));
        }
        let mut results = self.unseen_results(seen)?;
        results.extend(seen.results.iter().filter(|(chunk, _)| seen.chunks.contains_key(chunk)).cloned());
        match (&results[..], self.result()) {
            ([(_, bytes)], Some(result))
                if decode::<EpisodeResult>(bytes, MAX_SERVER_MESSAGE).as_ref() == Ok(result) =>
            {
                Ok(())
            }
            ([_], _) => Err(disagrees("the result in its metadata is not the one on /result".into())),
            (many, _) => Err(disagrees(format!("it has {} messages on /result in place of one", many.len()))),
        }
    }

    /// Messages on `/result` in chunks that were not seen to their end.
    fn unseen_results(&self, seen: &ReadParts) -> Result<Vec<(u64, Vec<u8>)>, BagError> {
        let mut reader = self.reader()?;
        for chunk in self.chunks().iter().filter(|chunk| !seen.chunks.contains_key(&chunk.offset)) {
            if chunk.may_have(topic::RESULT, self.channels()) {
                reader.start(chunk)?;
                reader.find(|_| Ok(None::<()>))?;
            }
        }
        Ok(reader.seen.results)
    }
}

fn add(hasher: &mut Hasher, file: &mut File, from: u64, to: u64, block: &mut [u8]) -> std::io::Result<()> {
    file.seek(SeekFrom::Start(from))?;
    let mut left = to.saturating_sub(from);
    while left > 0 {
        let wanted = (block.len() as u64).min(left) as usize;
        file.read_exact(&mut block[..wanted])?;
        hasher.update(&block[..wanted]);
        left -= wanted as u64;
    }
    Ok(())
}
