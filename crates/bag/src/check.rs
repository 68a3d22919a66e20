//! Whether a bag's bytes are those that its writer left.

use std::fs::File;
use std::io::{Read, Seek, SeekFrom};

use crc32fast::Hasher;
use fiatlux_proto::PROTOCOL;
use fiatlux_proto::v3::EpisodeResult;

use crate::scan::Sums;
use crate::{Bag, BagError, Completeness, topic};

/// Bytes that are read at once.
const BLOCK: usize = 1 << 20;

impl Bag {
    /// Reads the whole file and compares it with its checksums, and what stands in it twice with each other: a bit that has
    /// changed anywhere is found. [`Bag::open`] reads no chunk but the first; whoever reads messages finds what is wrong
    /// with their chunks.
    ///
    /// Checksums find accidents. They do not find somebody who writes the file anew.
    ///
    /// # Errors
    /// [`BagError::Damaged`]: a checksum differs, or is missing where our own writer made the file.
    /// [`BagError::Disagrees`]: the result in the metadata is not the one on `/result`, or the header has a field of no
    /// version up to this one.
    pub fn check(&self) -> Result<(), BagError> {
        let Sums { data, summary, is_ours } = self.sums;
        let whole = *self.completeness() == Completeness::Whole;
        let mut file = File::open(self.path()).map_err(BagError::io("open", self.path()))?;
        let mut covered = |what: &str, from: u64, to: u64, sum: u32| {
            if sum == 0 && !is_ours {
                // The format leaves checksums to the writer.
                return Ok(());
            }
            let found = checksum(&mut file, from, to).map_err(BagError::io("read", self.path()))?;
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
            // A bag that was not finished has none of them, and says so.
            _ => {}
        }
        if whole { self.check_doubles() } else { Ok(()) }
    }

    fn check_doubles(&self) -> Result<(), BagError> {
        let disagrees = |what: String| BagError::Disagrees { path: self.path().into(), what };
        let is_newer = self.header().protocol.is_some_and(|protocol| protocol.minor > PROTOCOL.minor);
        if let (Some(field), false) = (&self.unknown_field, is_newer) {
            return Err(disagrees(format!("its header has a field '{field}', which no header has")));
        }
        let results: Vec<EpisodeResult> = self.messages(topic::RESULT).collect::<Result<_, _>>()?;
        match (&results[..], self.result()) {
            ([message], Some(result)) if message == result => Ok(()),
            ([_], _) => Err(disagrees("the result in its metadata is not the one on /result".into())),
            (many, _) => Err(disagrees(format!("it has {} messages on /result in place of one", many.len()))),
        }
    }
}

fn checksum(file: &mut File, from: u64, to: u64) -> std::io::Result<u32> {
    file.seek(SeekFrom::Start(from))?;
    let (mut hasher, mut left) = (Hasher::new(), to.saturating_sub(from));
    let mut block = vec![0; BLOCK.min(left as usize)];
    while left > 0 {
        let wanted = (block.len() as u64).min(left) as usize;
        file.read_exact(&mut block[..wanted])?;
        hasher.update(&block[..wanted]);
        left -= wanted as u64;
    }
    Ok(hasher.finalize())
}
