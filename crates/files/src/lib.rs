//! Reads files whose paths come from outside: regular ones, up to a limit.
//!
//! A size from a file's metadata says nothing about a device or a pipe: a link to `/dev/zero` has 0 bytes and never ends, and
//! opening a pipe waits for a writer. [`read`] and [`open`] refuse both. Settings and secrets may come through a pipe or from
//! `/dev/null`: [`read_stream`] takes any kind of file, but stops at its limit, and does not wait for ever for a pipe's writer.

use std::fs::File;
use std::io::{self, Error, ErrorKind, Read as _};
use std::path::Path;
use std::sync::mpsc;
use std::time::Duration;

/// Time in which somebody must open the other end of a pipe, long enough for a program that is starting.
const PATIENCE: Duration = Duration::from_secs(5);

/// Opens a regular file, or what a link to one leads to.
///
/// # Errors
/// Those of the system; [`ErrorKind::InvalidInput`] for a device, a pipe, a socket or a folder, which is not opened.
pub fn open(path: &Path) -> io::Result<File> {
    // Opening a pipe waits for its other end, so its kind is looked at before.
    check_regular(std::fs::metadata(path)?.is_file())?;
    let file = File::open(path)?;
    check_regular(file.metadata()?.is_file())?;
    Ok(file)
}

fn check_regular(is_regular: bool) -> io::Result<()> {
    let error = || Error::new(ErrorKind::InvalidInput, "it is not a regular file; name a file");
    is_regular.then_some(()).ok_or_else(error)
}

/// The content of a regular file of at most `limit` bytes.
///
/// # Errors
/// As [`open`]; [`ErrorKind::FileTooLarge`] for a longer file.
pub fn read(path: &Path, limit: u64) -> io::Result<Vec<u8>> {
    limited(open(path)?, limit)
}

/// The text of a regular file of at most `limit` bytes.
///
/// # Errors
/// As [`read`]; [`ErrorKind::InvalidData`] where it is not UTF-8.
pub fn read_text(path: &Path, limit: u64) -> io::Result<String> {
    text(read(path, limit)?)
}

/// The text of a file of any kind of at most `limit` bytes: it waits for the end of a pipe.
///
/// # Errors
/// As [`open_stream`]; [`ErrorKind::FileTooLarge`]; [`ErrorKind::InvalidData`] where it is not UTF-8.
pub fn read_stream(path: &Path, limit: u64) -> io::Result<String> {
    text(limited(open_stream(path)?, limit)?)
}

/// Opens a file of any kind.
///
/// # Errors
/// Those of the system; [`ErrorKind::TimedOut`] for a pipe that nobody opens for writing within 5 s.
pub fn open_stream(path: &Path) -> io::Result<File> {
    if !is_pipe(path)? {
        return File::open(path);
    }
    let (sender, opened) = mpsc::channel();
    let path = path.to_owned();
    // Nothing but a writer wakes a thread that opens a pipe; without one it ends with the program.
    std::thread::Builder::new().name("fiatlux-pipe".into()).spawn(move || sender.send(File::open(path)))?;
    let error = |_| Error::new(ErrorKind::TimedOut, "it is a pipe that nobody writes to; name a file");
    opened.recv_timeout(PATIENCE).map_err(error)?
}

#[cfg(unix)]
fn is_pipe(path: &Path) -> io::Result<bool> {
    use std::os::unix::fs::FileTypeExt as _;
    Ok(std::fs::metadata(path)?.file_type().is_fifo())
}

#[cfg(not(unix))]
fn is_pipe(_: &Path) -> io::Result<bool> {
    Ok(false)
}

/// The rest of an open file, of at most `limit` bytes.
///
/// # Errors
/// Those of the system; [`ErrorKind::FileTooLarge`].
pub fn limited(file: File, limit: u64) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    file.take(limit.saturating_add(1)).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > limit {
        return Err(Error::new(ErrorKind::FileTooLarge, format!("it has more than {limit} bytes; that is the limit")));
    }
    Ok(bytes)
}

/// The text of a file. A mark of its order of bytes, which editors of Windows put first, is not part of it.
///
/// # Errors
/// [`ErrorKind::InvalidData`] where it is not UTF-8.
pub fn text(mut bytes: Vec<u8>) -> io::Result<String> {
    // What PowerShell writes by `>`.
    let is_wide = bytes.starts_with(&[0xff, 0xfe]) || bytes.starts_with(&[0xfe, 0xff]);
    if bytes.starts_with(b"\xef\xbb\xbf") {
        bytes.drain(..3);
    }
    let what = if is_wide { "it is UTF-16; save it as UTF-8" } else { "it is not text in UTF-8" };
    String::from_utf8(bytes).map_err(|_| Error::new(ErrorKind::InvalidData, what))
}

#[cfg(all(test, unix))]
#[allow(clippy::unwrap_used)]
mod tests {
    use std::os::unix::fs::symlink;
    use std::path::PathBuf;
    use std::process::Command;

    use super::*;

    /// A folder of this test, which goes with it.
    struct Folder(PathBuf);

    impl Folder {
        fn new(name: &str) -> Self {
            let path = std::env::temp_dir().join(format!("fiatlux-files-{name}-{}", std::process::id()));
            std::fs::create_dir_all(&path).unwrap();
            Self(path)
        }
    }

    impl Drop for Folder {
        fn drop(&mut self) {
            drop(std::fs::remove_dir_all(&self.0));
        }
    }

    #[test]
    fn texts_that_windows_wrote_are_read_or_named() {
        let read = |bytes: &[u8]| text(bytes.to_vec()).map_err(|error| error.to_string());
        assert_eq!(read(b"\xef\xbb\xbfkey:AA==\r\n"), Ok("key:AA==\r\n".into()));
        for wide in [&b"\xff\xfek\0e\0y\0"[..], b"\xfe\xff\0k\0e\0y"] {
            assert!(read(wide).unwrap_err().contains("UTF-16; save it as UTF-8"));
        }
        assert!(read(b"k\xe9y").unwrap_err().contains("not text in UTF-8"));
        // In the middle it is a letter like others.
        assert_eq!(read("a\u{feff}b".as_bytes()), Ok("a\u{feff}b".into()));
        assert_eq!(read(b"\xef\xbb\xbf"), Ok(String::new()));
    }

    #[test]
    fn files_and_links_to_them_are_read_up_to_the_limit() {
        let folder = Folder::new("plain");
        let (file, link) = (folder.0.join("file"), folder.0.join("link"));
        std::fs::write(&file, "twelve bytes").unwrap();
        symlink(&file, &link).unwrap();
        assert_eq!(read_text(&link, 12).unwrap(), "twelve bytes");
        assert_eq!(read_stream(&file, 12).unwrap(), "twelve bytes");
        assert_eq!(read(&file, 11).unwrap_err().kind(), ErrorKind::FileTooLarge);
        std::fs::write(&file, [0xff]).unwrap();
        assert_eq!(read_text(&file, 12).unwrap_err().kind(), ErrorKind::InvalidData);
        assert_eq!(read(&folder.0.join("none"), 12).unwrap_err().kind(), ErrorKind::NotFound);
    }

    /// None of these ends; the test hangs or fills the memory if one is read.
    #[test]
    fn devices_pipes_and_folders_are_refused_unread() {
        let folder = Folder::new("kinds");
        let (device, pipe) = (folder.0.join("device"), folder.0.join("pipe"));
        symlink("/dev/zero", &device).unwrap();
        assert!(Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        for path in [device.as_path(), pipe.as_path(), folder.0.as_path()] {
            assert_eq!(open(path).unwrap_err().kind(), ErrorKind::InvalidInput, "{}", path.display());
        }
        assert_eq!(read_stream(&pipe, 1000).unwrap_err().kind(), ErrorKind::TimedOut);
        // One that is written to late is read to its end.
        let mut writer = Command::new("sh").args(["-c", "sleep 0.2; echo late >\"$0\""]).arg(&pipe).spawn().unwrap();
        assert_eq!(read_stream(&pipe, 1000).unwrap(), "late\n");
        writer.wait().unwrap();
        // A stream stops at its limit.
        assert_eq!(read_stream(&device, 1000).unwrap_err().kind(), ErrorKind::FileTooLarge);
        assert_eq!(read_stream(Path::new("/dev/null"), 1000).unwrap(), "");
    }
}
