//! Why something could not be kept or found.

use std::io;
use std::path::{Path, PathBuf};

use thiserror::Error;

/// Why the store could not do what it was asked for.
#[derive(Debug, Error)]
pub enum StoreError {
    /// A file or folder of the store.
    #[error("cannot {action} {}; check its permissions and the space that is left", path.display())]
    Io {
        /// What was tried.
        action: &'static str,
        /// On what.
        path: PathBuf,
        /// Why.
        #[source]
        source: io::Error,
    },
    /// The database.
    #[error("the database cannot {action}; check the space that is left, and that nothing else writes to the folder")]
    Database {
        /// What was tried.
        action: &'static str,
        /// Why.
        #[source]
        source: sqlx::Error,
    },
    /// The store of bags.
    #[error("the store of bags cannot {action}; check its permissions and the space that is left")]
    Blobs {
        /// What was tried.
        action: &'static str,
        /// Why.
        #[source]
        source: object_store::Error,
    },
    /// The database was written by a later version.
    #[error("the database has version {found}, this program knows {known}; start the version that wrote it")]
    Newer {
        /// Of the database.
        found: i64,
        /// The last one that is known here.
        known: i64,
    },
    /// Something in the store that this program did not write so.
    #[error("{what} in the store cannot be read: {reason}; restore the folder from a backup")]
    Corrupt {
        /// What.
        what: String,
        /// Why.
        reason: String,
    },
    /// The system's random source.
    #[error("the system gives no random numbers")]
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
