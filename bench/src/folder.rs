//! A temporary folder for what a rival reads.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};

use super::BenchError;

/// A folder of this process; removed when it is dropped.
#[derive(Debug)]
pub(crate) struct Folder(PathBuf);

impl Folder {
    /// Makes one.
    pub fn new() -> Result<Self, BenchError> {
        static COUNT: AtomicUsize = AtomicUsize::new(0);
        let number = COUNT.fetch_add(1, Ordering::Relaxed);
        let folder = std::env::temp_dir().join(format!("fiatlux-bench-{}-{number}", std::process::id()));
        fs::create_dir_all(&folder)
            .map_err(|source| BenchError::Io { what: format!("make folder '{}'", folder.display()), source })?;
        Ok(Self(folder))
    }

    pub fn path(&self) -> &Path {
        &self.0
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        // A failure does no harm: the system cleans its temporary folder.
        fs::remove_dir_all(&self.0).ok();
    }
}
