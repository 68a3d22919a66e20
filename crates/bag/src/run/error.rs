use std::io;
use std::path::{Path, PathBuf};

use thiserror::Error;

#[derive(Debug, Error)]
pub enum LedgerError {
    #[error("cannot {action} {path}; check that it exists, its permissions, and the free disk space")]
    Io { action: &'static str, path: PathBuf, source: io::Error },
    #[error("{path} exists already; give the run another name, or move its folder away")]
    Exists { path: PathBuf },
    #[error(
        "{path}, line {line}: {reason}; restore the file as its server wrote it, or read it with the version that wrote \
         it"
    )]
    Line { path: PathBuf, line: usize, reason: String },
    /// An event that contradicts those before it. Nothing was written.
    #[error("{path}: {reason}")]
    Event { path: PathBuf, reason: String },
    /// An earlier write failed, so the file may end in part of a line.
    #[error("{path} may end in a partial line, because a write failed; free some space and start the server again")]
    Broken { path: PathBuf },
}

impl LedgerError {
    pub(super) fn io(action: &'static str, path: &Path) -> impl FnOnce(io::Error) -> Self {
        move |source| Self::Io { action, path: path.into(), source }
    }
}
