use std::io;
use std::path::{Path, PathBuf};

use thiserror::Error;

/// Why a journal could not be read or written.
#[derive(Debug, Error)]
pub enum LedgerError {
    /// The file or its folder.
    #[error("cannot {action} {path}; check that it is there, its permissions, and the space that is left")]
    Io {
        /// What was tried.
        action: &'static str,
        /// The file.
        path: PathBuf,
        /// Why.
        #[source]
        source: io::Error,
    },
    /// The journal is there already.
    #[error("{path} is there already; give the run another name, or move its folder away")]
    Exists {
        /// The file.
        path: PathBuf,
    },
    /// A line that no server wrote so.
    #[error(
        "{path}, line {line}: {reason}; bring back the file as its server left it, or read it with the version that wrote \
         it"
    )]
    Line {
        /// The file.
        path: PathBuf,
        /// Number of the line, from 1.
        line: usize,
        /// What is wrong.
        reason: String,
    },
    /// An event that does not follow from what was before. Nothing was written.
    #[error("{path}: {reason}")]
    Event {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// An earlier write failed, and what of it is in the file is not known.
    #[error("{path} may end in half a line, because a write failed; free some space and start the server again")]
    Broken {
        /// The file.
        path: PathBuf,
    },
}

impl LedgerError {
    pub(super) fn io(action: &'static str, path: &Path) -> impl FnOnce(io::Error) -> Self {
        move |source| Self::Io { action, path: path.into(), source }
    }
}
