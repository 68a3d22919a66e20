use std::io;
use std::path::{Path, PathBuf};

use fiatlux_bag::BagError;
use thiserror::Error;

#[derive(Debug, Error)]
pub enum StoreError {
    #[error("cannot {action} {}; check its permissions and the free disk space", path.display())]
    Io { action: &'static str, path: PathBuf, source: io::Error },
    #[error(
        "{store} has no leaderboard; name the folder of `scorer serve`, and its --database where it has one, or make a new leaderboard with `scorer admin init`"
    )]
    Nothing { store: String },
    #[error("{store} has a leaderboard already; name a new place")]
    Taken { store: String },
    #[error("the database cannot {action}; check that it runs and has free disk space")]
    Database { action: &'static str, source: sqlx::Error },
    #[error("the store of bags cannot {action}; check its permissions and the free disk space")]
    Blobs { action: &'static str, source: object_store::Error },
    #[error("the database has version {found}, this program knows up to {known}; start the version that wrote it")]
    Newer { found: i64, known: i64 },
    #[error("other scorers run on {store}; stop all of them first")]
    InUse { store: String },
    #[error("{what} in the store cannot be read: {reason}; restore it from a backup")]
    Corrupt { what: String, reason: String },
    #[error("a bag in the store cannot be read now")]
    Bag(#[source] BagError),
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
