//! Allows one evaluation at a time in a folder.

use std::fs::{File, TryLockError};
use std::path::Path;

use super::{EvaluateError, folder};

/// Name of the lock file. It is never removed: a removed file could be locked twice.
const NAME: &str = "evaluate.lock";

/// Held while an evaluation runs. The system releases it with the process, however that ends.
#[derive(Debug)]
pub(super) struct Lock {
    _file: File,
}

impl Lock {
    /// Locks a folder.
    ///
    /// # Errors
    /// Another evaluation holds it, or the file cannot be made.
    pub(super) fn take(out: &Path) -> Result<Self, EvaluateError> {
        let path = out.join(NAME);
        let file = File::options().create(true).append(true).open(&path).map_err(|error| folder(&path, error))?;
        match file.try_lock() {
            Ok(()) => Ok(Self { _file: file }),
            Err(TryLockError::WouldBlock) => Err(folder(
                out,
                "another evaluation is at work in it; wait for its end, or name another folder with --out",
            )),
            Err(TryLockError::Error(error)) => Err(folder(&path, error)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_is_taken_once_at_a_time() {
        let out = std::env::temp_dir().join(format!("fiatlux-lock-{}", std::process::id()));
        std::fs::create_dir_all(&out).expect("makes a folder");
        let first = Lock::take(&out).expect("it is free");
        let error = Lock::take(&out).expect_err("it is taken").to_string();
        assert!(error.contains("another evaluation is at work in it") && error.contains("--out"), "{error}");
        drop(first);
        Lock::take(&out).expect("it is free again");
        std::fs::remove_dir_all(out).expect("removes");
    }
}
