//! Folders among the temporary files.

use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Once;
use std::sync::atomic::{AtomicU64, Ordering};

use crate::lock_folder;

/// Begins their names: whatever else is called after this project is somebody's own.
const PREFIX: &str = "fiatlux-temporary-";
/// The file that its process locks: a folder without its process is one that was left.
const LOCK: &str = "temporary.lock";

/// A new folder among the temporary files, removed with its last user. Of a process that was forked, the first one removes it.
#[derive(Debug)]
pub struct Temporary {
    path: PathBuf,
    process: u32,
    _lock: File,
}

impl Temporary {
    /// A folder `fiatlux-temporary-NAME-...`. The first one of a process removes what processes that were killed have left.
    ///
    /// # Errors
    /// It cannot be made.
    pub fn new(name: &str) -> io::Result<Self> {
        static COUNT: AtomicU64 = AtomicU64::new(0);
        static SWEPT: Once = Once::new();
        let (process, all) = (std::process::id(), std::env::temp_dir());
        SWEPT.call_once(|| sweep(&all));
        loop {
            let path = all.join(format!("{PREFIX}{name}-{process}-{}", COUNT.fetch_add(1, Ordering::Relaxed)));
            match fs::create_dir(&path) {
                // Otherwise another process has just taken it for one that was left.
                Ok(()) => {
                    if let Some(lock) = lock_folder(&path, LOCK)? {
                        return Ok(Self { path, process, _lock: lock });
                    }
                }
                // Left by another process with this number, perhaps in another container.
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
                Err(error) => return Err(error),
            }
        }
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.path
    }
}

impl Drop for Temporary {
    fn drop(&mut self) {
        if self.process == std::process::id() {
            // Left among the temporary files at worst.
            let _ = fs::remove_dir_all(&self.path);
        }
    }
}

/// Removes folders whose lock nobody holds.
fn sweep(all: &Path) {
    for folder in fs::read_dir(all).into_iter().flatten().flatten() {
        if folder.file_name().to_string_lossy().starts_with(PREFIX)
            && let Ok(lock) = fiatlux_files::open(&folder.path().join(LOCK))
            && lock.try_lock().is_ok()
        {
            // Another user's, perhaps.
            let _ = fs::remove_dir_all(folder.path());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Guards the disk against processes that are killed, and folders in use against those that clear up.
    #[test]
    fn folders_that_were_left_are_removed() {
        let all = std::env::temp_dir().join(format!("fiatlux-temporary-{}", std::process::id()));
        let names =
            ["fiatlux-temporary-rows-1-0", "fiatlux-temporary-rows-2-0", "fiatlux-board", "fiatlux-temporary-x"];
        let [used, left, other, new] = names.map(|name| all.join(name));
        for folder in [&used, &left, &other, &new] {
            fs::create_dir_all(folder).expect("made");
        }
        let lock = lock_folder(&used, LOCK).expect("the file is made");
        for unlocked in [&left, &other] {
            drop(lock_folder(unlocked, LOCK).expect("the file is made"));
        }
        sweep(&all);
        assert!(used.is_dir() && !left.exists() && other.is_dir() && new.is_dir());
        drop(lock);
        sweep(&all);
        assert!(!used.exists());
        fs::remove_dir_all(all).expect("removed");
    }
}
