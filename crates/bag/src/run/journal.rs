//! Lines of a journal, and the chain through them.

use std::fs::{self, File};
use std::io::{BufRead, BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use data_encoding::HEXLOWER;
use serde::Serialize;
use serde::de::DeserializeOwned;
use sha2::{Digest, Sha256};

use super::{Event, LedgerError};
use crate::leftover::is_leftover;

/// End of a journal's file name, after the server's name.
const ENDING: &str = ".run.jsonl";

/// Maximum length of a line, bytes. The registration of 10,000 episodes takes about 400,000.
const MAX_LINE: usize = 2 << 20;

/// Maximum size of a journal, bytes: enough for the maximum number of attempts of every episode.
const MAX_FILE: u64 = 2 << 30;

/// More than the last line of a finished journal has, bytes.
const LAST_LINE: u64 = 4096;

/// Text between a line's own members and the 64 digits of its link.
const BEFORE_LINK: &str = ",\"link\":\"";
const AFTER_LINK: &str = "\"}";

/// Path of a server's journal in the folder of a run; it need not exist.
pub fn journal_of(folder: &Path, server: &str) -> PathBuf {
    folder.join(format!("{server}{ENDING}"))
}

/// The journals in the folder of a run, sorted by name.
pub fn journals(folder: &Path) -> Result<Vec<PathBuf>, LedgerError> {
    let failed = || LedgerError::io("read the folder", folder);
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).map_err(failed())? {
        let entry = entry.map_err(failed())?;
        if is_journal(&entry.path()) && !is_leftover(&entry.path()) {
            found.push(entry.path());
        }
    }
    found.sort();
    Ok(found)
}

/// True if a journal ends in a partial line: its server died while it wrote, or the file was cut.
pub fn is_torn(path: &Path) -> Result<bool, LedgerError> {
    let failed = || LedgerError::io("read", path);
    let mut file = fiatlux_files::open(path).map_err(LedgerError::io("open", path))?;
    if file.metadata().map_err(failed())?.len() == 0 {
        return Ok(false);
    }
    let mut last = [0];
    file.seek(SeekFrom::End(-1)).and_then(|_| file.read_exact(&mut last)).map_err(failed())?;
    Ok(last != *b"\n")
}

/// True if a journal ends as that of a finished run does. Nothing else of it is read or checked, so that a server with
/// thousands of finished runs starts at once.
pub fn ends_finished(path: &Path) -> Result<bool, LedgerError> {
    let failed = || LedgerError::io("read", path);
    let mut file = fiatlux_files::open(path).map_err(LedgerError::io("open", path))?;
    let length = file.metadata().map_err(failed())?.len();
    file.seek(SeekFrom::Start(length.saturating_sub(LAST_LINE))).map_err(failed())?;
    let mut end = Vec::new();
    file.take(LAST_LINE).read_to_end(&mut end).map_err(failed())?;
    let Some(end) = end.strip_suffix(b"\n") else { return Ok(false) };
    let line = end.rsplit(|byte| *byte == b'\n').next().unwrap_or_default();
    let at = line.len().checked_sub(BEFORE_LINK.len() + 64 + AFTER_LINK.len());
    let Some((members, _)) = at.and_then(|at| line.split_at_checked(at)) else { return Ok(false) };
    let last = serde_json::from_slice(&[members, b"}"].concat());
    Ok(matches!(last, Ok(Event::Finished { .. } | Event::Sealed { .. })))
}

pub(crate) fn is_journal(path: &Path) -> bool {
    path.file_name().and_then(|name| name.to_str()).is_some_and(|name| name.ends_with(ENDING))
}

/// The chain so far: the link of the last line, and where that line ends in the file.
#[derive(Debug, Clone, Default)]
pub(super) struct Chain {
    /// Empty before the first line.
    pub link: String,
    pub length: u64,
    pub lines: usize,
}

impl Chain {
    fn link_of(&self, members: &[u8]) -> String {
        let hash = Sha256::new().chain_update(&self.link).chain_update(members).finalize();
        HEXLOWER.encode(&hash)
    }

    /// The line of an entry, and the chain after it; `None` if the entry exceeds the maximum length.
    pub fn line(&self, entry: &impl Serialize) -> Option<(String, Self)> {
        let mut members = serde_json::to_string(entry).ok()?;
        members.pop();
        let link = self.link_of(members.as_bytes());
        let line = format!("{members}{BEFORE_LINK}{link}{AFTER_LINK}\n");
        let length = self.length + line.len() as u64;
        (line.len() <= MAX_LINE).then(|| (line, Self { link, length, lines: self.lines + 1 }))
    }

    /// Reads a line without its line break, and advances the chain.
    pub fn read<T: DeserializeOwned>(&mut self, line: &[u8]) -> Result<T, String> {
        let no_link = || "it does not end with a valid link".to_owned();
        let (members, end) = line
            .len()
            .checked_sub(BEFORE_LINK.len() + 64 + AFTER_LINK.len())
            .and_then(|at| line.split_at_checked(at))
            .ok_or_else(no_link)?;
        let link = self.link_of(members);
        if end != format!("{BEFORE_LINK}{link}{AFTER_LINK}").as_bytes() {
            return Err("the line was changed, or a line before it is missing: the chain breaks here".into());
        }
        let entry = serde_json::from_slice(&[members, b"}"].concat());
        let entry = entry.map_err(|error| format!("it cannot be read ({error})"))?;
        let (length, lines) = (self.length + line.len() as u64 + 1, self.lines + 1);
        *self = Self { link, length, lines };
        Ok(entry)
    }
}

pub(super) struct Lines<'a> {
    path: &'a Path,
    reader: BufReader<File>,
    buffer: Vec<u8>,
    pub chain: Chain,
}

impl<'a> Lines<'a> {
    pub fn open(path: &'a Path) -> Result<Self, LedgerError> {
        let file = fiatlux_files::open(path).map_err(LedgerError::io("open", path))?;
        let size = file.metadata().map_err(LedgerError::io("read", path))?.len();
        let lines = Self { path, reader: BufReader::new(file), buffer: Vec::new(), chain: Chain::default() };
        if size > MAX_FILE {
            return Err(lines.wrong(format!("a journal of {size} bytes; the limit is {MAX_FILE}")));
        }
        Ok(lines)
    }

    /// The next entry; `None` at the end, or at a partial line.
    pub fn next<T: DeserializeOwned>(&mut self) -> Result<Option<T>, LedgerError> {
        self.buffer.clear();
        let mut line = (&mut self.reader).take(MAX_LINE as u64 + 1);
        line.read_until(b'\n', &mut self.buffer).map_err(LedgerError::io("read", self.path))?;
        if self.buffer.len() > MAX_LINE {
            return Err(self.wrong(format!("it has more than {MAX_LINE} bytes")));
        }
        let Some(line) = self.buffer.strip_suffix(b"\n") else { return Ok(None) };
        let read = self.chain.read(line);
        read.map(Some).map_err(|reason| self.wrong(reason))
    }

    /// An error in the line after those that were read.
    fn wrong(&self, reason: String) -> LedgerError {
        LedgerError::Line { path: self.path.into(), line: self.chain.lines + 1, reason }
    }

    /// An error in the line that was read last.
    pub fn wrong_line(&self, reason: String) -> LedgerError {
        LedgerError::Line { path: self.path.into(), line: self.chain.lines.max(1), reason }
    }
}
