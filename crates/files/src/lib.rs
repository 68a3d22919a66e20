//! Reads files whose paths come from outside: regular ones, up to a limit.
//!
//! A size from a file's metadata says nothing about a device or a pipe: a link to `/dev/zero` has 0 bytes and never ends, and
//! opening a pipe waits for a writer. [`read`] and [`open`] refuse both. Settings and secrets may come through a pipe or from
//! `/dev/null`: [`read_stream`] takes any kind of file, but stops at its limit.

use std::fs::File;
use std::io::{self, Error, ErrorKind, Read as _};
use std::path::Path;

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
/// Those of the system; [`ErrorKind::FileTooLarge`]; [`ErrorKind::InvalidData`] where it is not UTF-8.
pub fn read_stream(path: &Path, limit: u64) -> io::Result<String> {
    text(limited(File::open(path)?, limit)?)
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

fn text(bytes: Vec<u8>) -> io::Result<String> {
    String::from_utf8(bytes).map_err(|_| Error::new(ErrorKind::InvalidData, "it is not text in UTF-8"))
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
        // A stream stops at its limit.
        assert_eq!(read_stream(&device, 1000).unwrap_err().kind(), ErrorKind::FileTooLarge);
        assert_eq!(read_stream(Path::new("/dev/null"), 1000).unwrap(), "");
    }
}
