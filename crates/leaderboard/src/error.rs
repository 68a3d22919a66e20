//! Errors of the store.

use std::io;
use std::path::{Path, PathBuf};

use thiserror::Error;

/// Why the store could not be read or written.
#[derive(Debug, Error)]
pub enum StoreError {
    /// A file or folder of the store cannot be used.
    #[error("cannot {action} {}; check its permissions and the free disk space", path.display())]
    Io {
        /// Verb of the operation that failed, such as `open`.
        action: &'static str,
        /// File or folder that the operation was for.
        path: PathBuf,
        /// The operating system's error.
        #[source]
        source: io::Error,
    },
    /// The folder is not that of a service.
    #[error(
        "{} has no leaderboard; name the folder of `scorer serve`, or make a new leaderboard with `scorer admin init`",
        folder.display()
    )]
    Nothing { folder: PathBuf },
    /// A statement failed in the database.
    #[error("the database cannot {action}; check the free disk space, and that nothing else writes to the folder")]
    Database {
        /// What the database could not do, such as `be opened`.
        action: &'static str,
        /// The error that SQLite reported.
        #[source]
        source: sqlx::Error,
    },
    /// An operation failed in the store of bags.
    #[error("the store of bags cannot {action}; check its permissions and the free disk space")]
    Blobs {
        /// What the store could not do, such as `read a file`.
        action: &'static str,
        /// The error that the store of bags reported.
        #[source]
        source: object_store::Error,
    },
    /// The database was written by a later version of the program.
    #[error("the database has version {found}, this program knows up to {known}; start the version that wrote it")]
    Newer {
        found: i64,
        /// Latest version that this program can read.
        known: i64,
    },
    /// Something in the store is not as this program writes it.
    #[error("{what} in the store cannot be read: {reason}; restore the folder from a backup")]
    Corrupt {
        /// What is damaged, with its id where it has one.
        what: String,
        reason: String,
    },
    /// The system's random source failed, so no token can be made.
    #[error("the system's random source failed")]
    Random(#[source] getrandom::Error),
}

impl StoreError {
    pub(crate) fn io(action: &'static str, path: &Path) -> impl FnOnce(io::Error) -> Self {
        move |source| Self::Io { action, path: path.into(), source }
    }

    pub(crate) fn database(action: &'static str) -> impl FnOnce(sqlx::Error) -> Self {
        move |source| Self::Database { action, source }
    }

    pub(crate) fn blobs(action: &'static str) -> impl FnOnce(object_store::Error) -> Self {
        move |source| Self::Blobs { action, source }
    }

    pub(crate) fn corrupt(what: impl Into<String>, reason: impl ToString) -> Self {
        Self::Corrupt { what: what.into(), reason: reason.to_string() }
    }
}
