//! Keeps a second writer out of a folder.

use std::fs::{File, TryLockError};
use std::io;
use std::path::Path;

/// Locks a file of this name in a folder, for as long as the result is held; the system releases it with the process, however
/// that ends. `None` if another process, or another part of this one, holds it. The file stays: a removed one could be locked
/// twice.
pub fn lock_folder(folder: &Path, name: &str) -> io::Result<Option<File>> {
    let file = File::options().create(true).append(true).open(folder.join(name))?;
    match file.try_lock() {
        Ok(()) => Ok(Some(file)),
        Err(TryLockError::WouldBlock) => Ok(None),
        Err(TryLockError::Error(error)) => Err(error),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_is_taken_once_at_a_time() {
        let folder = std::env::temp_dir().join(format!("fiatlux-lock-{}", std::process::id()));
        std::fs::create_dir_all(&folder).expect("makes a folder");
        let take = || lock_folder(&folder, "test.lock").expect("the file is made");
        let first = take();
        assert!(first.is_some() && take().is_none());
        drop(first);
        assert!(take().is_some());
        std::fs::remove_dir_all(&folder).expect("removes");
        assert!(lock_folder(&folder, "test.lock").is_err());
    }
}
