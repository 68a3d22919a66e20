//! Files of keys: writes them, and checks who may read them.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Read as _, Write as _};
use std::os::unix::fs::{OpenOptionsExt as _, PermissionsExt as _};
use std::path::Path;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;

use crate::{AccessError, FormatError};

/// Maximum size of a file of keys, bytes: a path to another kind of file is refused before it fills the memory.
const MAX_FILE: u64 = 1 << 20;

/// Creates a file with this text and these permission bits (0o600 for a secret). It is on disk when this returns.
pub fn write_new(path: &Path, text: &str, mode: u32) -> Result<(), AccessError> {
    let write = |source: io::Error| match source.kind() {
        io::ErrorKind::AlreadyExists => AccessError::Exists { path: path.to_owned() },
        _ => AccessError::Write { path: path.to_owned(), source },
    };
    let mut file = OpenOptions::new().write(true).create_new(true).mode(mode).open(path).map_err(write)?;
    let written = file.write_all(text.as_bytes()).and_then(|()| file.sync_all());
    // Half a key is useless, and would block a second try.
    written.inspect_err(|_| drop(fs::remove_file(path))).map_err(write)
}

pub fn read_public(path: &Path) -> Result<String, AccessError> {
    text_of(&open(path)?, path)
}

/// Reads a file that only its owner may read. A file of another kind is refused as such, with any mode.
pub fn read_secret<T>(path: &Path, parse: impl FnOnce(&str) -> Result<T, AccessError>) -> Result<T, AccessError> {
    let file = open(path)?;
    let secret = parse(&text_of(&file, path)?)?;
    check_private(&file, path)?;
    Ok(secret)
}

/// Checks that only its owner may read an open file; `path` is for the message.
pub fn check_private(file: &File, path: &Path) -> Result<(), AccessError> {
    let source = |source| AccessError::Read { path: path.to_owned(), source };
    let mode = file.metadata().map_err(source)?.permissions().mode() & 0o7777;
    if mode & 0o077 == 0 { Ok(()) } else { Err(AccessError::Exposed { path: path.to_owned(), mode }) }
}

fn open(path: &Path) -> Result<File, AccessError> {
    File::open(path).map_err(|source| AccessError::Read { path: path.to_owned(), source })
}

fn text_of(file: &File, path: &Path) -> Result<String, AccessError> {
    let error = |source| AccessError::Read { path: path.to_owned(), source };
    let mut text = String::new();
    file.take(MAX_FILE + 1).read_to_string(&mut text).map_err(error)?;
    if text.len() as u64 > MAX_FILE {
        return Err(error(io::Error::new(io::ErrorKind::FileTooLarge, "it is too large for a file of keys")));
    }
    Ok(text)
}

/// The lines that are not empty, without comments, with their numbers from 1. `#` starts a comment at the start of a word.
pub fn lines(text: &str) -> impl Iterator<Item = (usize, &str)> {
    let numbered = text.lines().enumerate().map(|(index, line)| (index + 1, line));
    numbered.map(|(number, line)| (number, without_comment(line).trim())).filter(|(_, line)| !line.is_empty())
}

fn without_comment(line: &str) -> &str {
    let starts = line.match_indices('#').map(|(at, _)| at);
    let comment = starts.into_iter().find(|&at| at == 0 || line[..at].ends_with(char::is_whitespace));
    comment.map_or(line, |at| &line[..at])
}

/// The only line of a file, comments aside, with its number.
pub fn only_line<'a>(
    path: &Path,
    text: &'a str,
    field: &'static str,
    remedy: &'static str,
) -> Result<(usize, &'a str), AccessError> {
    let mut lines = lines(text);
    match (lines.next(), lines.next()) {
        (Some(line), None) => Ok(line),
        (None, _) => Err(FormatError::new(field, "the file is empty", remedy).at(path, 1)),
        (_, Some((number, _))) => Err(FormatError::new(field, "the file has a second line", remedy).at(path, number)),
    }
}

pub fn encode(prefix: &str, bytes: &[u8; 32]) -> String {
    format!("{prefix}:{}", STANDARD.encode(bytes))
}

/// Reads the output of [`encode`]. Errors do not repeat the text, which may be a secret.
pub fn decode(text: &str, prefix: &str, field: &'static str, remedy: &'static str) -> Result<[u8; 32], FormatError> {
    let refuse = |problem: String| FormatError::new(field, problem, remedy);
    let coded = text.strip_prefix(prefix).and_then(|rest| rest.strip_prefix(':'));
    let coded = coded.ok_or_else(|| refuse(format!("it does not begin with '{prefix}:'")))?;
    let bytes = STANDARD.decode(coded).map_err(|_| refuse("it is not base64".into()))?;
    let length = bytes.len();
    bytes.try_into().map_err(|_| refuse(format!("it has {length} bytes, not 32")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn comments_and_empty_lines_say_nothing() {
        let text = "# head\n\n a b # tail\n#x\nkey#1\n";
        assert_eq!(lines(text).collect::<Vec<_>>(), [(3, "a b"), (5, "key#1")]);
    }
}
