//! Names for files that are not complete yet.

use std::ffi::OsString;
use std::path::{Path, PathBuf};

/// A name next to `path` that no other process uses.
pub fn part_of(path: &Path) -> PathBuf {
    let mut name = path.file_name().map_or_else(OsString::new, OsString::from);
    name.push(format!(".{}.part", std::process::id()));
    path.with_file_name(name)
}
