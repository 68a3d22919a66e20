//! Files of keys: writes them, and checks who may read them.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Read as _, Write as _};
use std::os::unix::fs::{FileTypeExt as _, MetadataExt as _, OpenOptionsExt as _, PermissionsExt as _};
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

/// Set to 1, it lets secrets be read whatever their modes: some disks have none, such as those of Windows in WSL.
pub const ANY_MODE: &str = "FIATLUX_ANY_MODE";

/// Reads a file that only its owner may read, or root's that root lets a group read, as orchestrators mount secrets. A file of
/// another kind is refused as such, with any mode.
pub fn read_secret<T>(path: &Path, parse: impl FnOnce(&str) -> Result<T, AccessError>) -> Result<T, AccessError> {
    let file = open(path)?;
    // chmod helps no device, and would break it for others.
    let kind = file.metadata().map_err(|source| AccessError::Read { path: path.to_owned(), source })?.file_type();
    if !kind.is_file() && !kind.is_fifo() {
        return Err(AccessError::Kind { path: path.to_owned() });
    }
    let secret = parse(&text_of(&file, path)?)?;
    check_private(&file, path)?;
    Ok(secret)
}

/// Checks that nobody else may read an open file; `path` is for the message.
pub fn check_private(file: &File, path: &Path) -> Result<(), AccessError> {
    let source = |source| AccessError::Read { path: path.to_owned(), source };
    let found = file.metadata().map_err(source)?;
    let mode = found.permissions().mode() & 0o7777;
    let may = is_private(mode, found.uid()) || std::env::var_os(ANY_MODE).is_some_and(|set| set == "1");
    if may { Ok(()) } else { Err(AccessError::Exposed { path: path.to_owned(), mode }) }
}

/// True if these permission bits keep a secret. Who is in a group is for root to say, who gave root's file to it.
fn is_private(mode: u32, owner: u32) -> bool {
    mode & 0o077 == 0 || owner == 0 && mode & 0o037 == 0
}

fn open(path: &Path) -> Result<File, AccessError> {
    fiatlux_files::open_stream(path).map_err(|source| AccessError::Read { path: path.to_owned(), source })
}

fn text_of(file: &File, path: &Path) -> Result<String, AccessError> {
    let error = |source| AccessError::Read { path: path.to_owned(), source };
    let mut bytes = Vec::new();
    file.take(MAX_FILE + 1).read_to_end(&mut bytes).map_err(error)?;
    if bytes.len() as u64 > MAX_FILE {
        return Err(error(io::Error::new(io::ErrorKind::FileTooLarge, "it is too large for a file of keys")));
    }
    fiatlux_files::text(bytes).map_err(error)
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
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn secrets_are_the_owners_or_of_a_group_that_root_gave_them_to() {
        for (mode, owner, may) in [
            (0o600, 1000, true),
            (0o400, 1000, true),
            (0o400, 0, true),
            // A Kubernetes secret with fsGroup, and one of Docker Swarm.
            (0o440, 0, true),
            (0o640, 0, true),
            (0o440, 1000, false),
            (0o640, 1000, false),
            (0o660, 0, false),
            (0o444, 0, false),
            (0o644, 0, false),
            (0o777, 0, false),
            (0o602, 1000, false),
            (0o710, 1000, false),
        ] {
            assert_eq!(is_private(mode, owner), may, "{mode:o} of {owner}");
        }
    }

    #[test]
    fn a_device_is_not_a_file_of_keys() {
        let error = read_secret(Path::new("/dev/null"), |_| Ok(())).unwrap_err().to_string();
        assert!(error.contains("not a file") && !error.contains("chmod"), "{error}");
    }

    #[test]
    fn comments_and_empty_lines_say_nothing() {
        let text = "# head\n\n a b # tail\n#x\nkey#1\n";
        assert_eq!(lines(text).collect::<Vec<_>>(), [(3, "a b"), (5, "key#1")]);
    }
}
