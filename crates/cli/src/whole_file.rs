//! Files that are written completely or not at all.

use std::fs;
use std::io;
use std::path::Path;

/// Writes a file completely or not at all: under another name, then moved. An existing file keeps its permissions; a
/// target that is not a regular file, such as `/dev/stdout`, is written directly.
///
/// # Errors
/// On failure, `path` is unchanged.
pub fn write_whole(path: &Path, content: impl AsRef<[u8]>) -> io::Result<()> {
    // Follows links: the target is replaced, not the link.
    let path = &fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
    let there = fs::metadata(path).ok();
    if there.as_ref().is_some_and(|there| !there.is_file()) {
        return fs::write(path, content);
    }
    let mut name = path.file_name().unwrap_or_default().to_owned();
    name.push(format!(".{}.part", std::process::id()));
    let part = path.with_file_name(name);
    let written = fs::write(&part, content)
        .and_then(|()| there.map_or(Ok(()), |there| fs::set_permissions(&part, there.permissions())))
        .and_then(|()| fs::rename(&part, path));
    written.inspect_err(|_| drop(fs::remove_file(&part)))
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use std::os::unix::fs::{PermissionsExt, symlink};

    use super::*;

    #[test]
    fn a_file_is_replaced_whole_and_nothing_else_is_left() {
        let folder = std::env::temp_dir().join(format!("fiatlux-whole-{}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        let (file, link) = (folder.join("a.json"), folder.join("link"));
        write_whole(&file, "old").unwrap();
        fs::set_permissions(&file, PermissionsExt::from_mode(0o640)).unwrap();
        symlink(&file, &link).unwrap();
        // A reader that opened the old file still has all of it.
        let open = fs::File::open(&file).unwrap();
        write_whole(&link, "new").unwrap();
        assert_eq!(
            (io::read_to_string(open).unwrap().as_str(), fs::read_to_string(&file).unwrap().as_str()),
            ("old", "new")
        );
        assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
        assert_eq!(fs::metadata(&file).unwrap().permissions().mode() & 0o777, 0o640);
        write_whole("/dev/null".as_ref(), "gone").unwrap();
        assert!(write_whole(&folder.join("no/such"), "x").is_err() && write_whole(&folder, "x").is_err());
        assert_eq!(fs::read_dir(&folder).unwrap().count(), 2);
        fs::remove_dir_all(folder).unwrap();
    }
}
