use std::io;
use std::path::{Path, PathBuf};

use thiserror::Error;

/// Why a journal could not be read or written.
#[derive(Debug, Error)]
pub enum LedgerError {
    /// The file or its folder.
    #[error("cannot {action} {path}; check that it exists, its permissions, and the space that is left")]
    Io {
        /// What was tried: a verb for the message, such as `open`.
        action: &'static str,
        path: PathBuf,
        /// What the operating system says.
        #[source]
        source: io::Error,
    },
    /// The journal exists already.
    #[error("{path} exists already; give the run another name, or move its folder away")]
    Exists { path: PathBuf },
    /// A line that no server wrote so.
    #[error(
        "{path}, line {line}: {reason}; bring back the file as its server left it, or read it with the version that wrote \
         it"
    )]
    Line {
        /// Path of the journal, for the message.
        path: PathBuf,
        /// Number of the line, from 1.
        line: usize,
        reason: String,
    },
    /// An event that does not follow from what was before. Nothing was written.
    #[error("{path}: {reason}")]
    Event {
        /// Path of the journal, for the message.
        path: PathBuf,
        reason: String,
    },
    /// An earlier write failed, and what of it is in the file is not known.
    #[error("{path} may end in half a line, because a write failed; free some space and start the server again")]
    Broken {
        /// Path of the journal, for the message.
        path: PathBuf,
    },
}

impl LedgerError {
    pub(super) fn io(action: &'static str, path: &Path) -> impl FnOnce(io::Error) -> Self {
        move |source| Self::Io { action, path: path.into(), source }
    }
}
