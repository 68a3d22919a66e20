//! Why a bag could not be written or read.

use std::io;
use std::path::{Path, PathBuf};

use fiatlux_proto::v3::Version;
use fiatlux_proto::{DecodeError, PROTOCOL};
use mcap::McapError;
use thiserror::Error;

/// Why a bag could not be written or read.
#[derive(Debug, Error)]
pub enum BagError {
    /// The file could not be opened, made, read or renamed.
    #[error("cannot {action} {path}; check that it exists, its permissions, and the space that is left")]
    Io {
        /// What was tried: a verb for the message, such as `open`.
        action: &'static str,
        /// Path of the file that it was tried on.
        path: PathBuf,
        /// What the operating system says.
        #[source]
        source: io::Error,
    },
    /// A bag of that name exists already.
    #[error("{path} exists already; move it away or choose another name")]
    Exists { path: PathBuf },
    /// The MCAP writer failed.
    #[error("cannot write {path}; free some space and record the episode again")]
    Write {
        /// Path of the bag that was being written.
        path: PathBuf,
        /// What the MCAP writer says.
        #[source]
        source: Box<McapError>,
    },
    /// A topic that bags do not have.
    #[error("bags have no topic {topic}; use one of fiatlux_bag::topic")]
    Topic { topic: String },
    /// A header or result that metadata cannot hold.
    #[error("the {what} does not read back as it was given; its numbers must be finite")]
    Values {
        /// Which message it is: `header` or `result`.
        what: &'static str,
    },
    /// The file is not a bag of this project.
    #[error("{path} is not a bag: {reason}; name an .mcap file that a recorder wrote")]
    NotABag {
        /// Path of the file that was opened.
        path: PathBuf,
        /// What it lacks that every bag has.
        reason: String,
    },
    /// A bag of another major version.
    #[error(
        "{path} is of protocol {found}, this program reads {PROTOCOL}; use the programs of its own version, or \
         record the episode again"
    )]
    Version {
        /// Path of the bag, for the message.
        path: PathBuf,
        found: Version,
    },
    /// The reader's [`Patience`](crate::Patience) is over.
    #[error("{path} takes longer to read than its reader allows: it has far more in it than an episode")]
    Slow {
        /// Path of the bag, for the message.
        path: PathBuf,
    },
    /// Bytes of the file are wrong.
    #[error(
        "{path} was changed after it was recorded, or damaged on the way, at byte {offset}: {reason}; ask for the file \
         again, or record the episode again"
    )]
    Damaged {
        path: PathBuf,
        offset: u64,
        /// What is wrong with the record there.
        reason: String,
    },
    /// What stands in it twice is not the same.
    #[error("{path} was changed: {what}; record the episode again")]
    Disagrees {
        /// Path of the bag that was changed.
        path: PathBuf,
        what: String,
    },
    /// A message that cannot be read.
    #[error("{path}: step {step} of {topic} cannot be read; record the episode again with this version")]
    Message {
        /// Path of the bag, for the message.
        path: PathBuf,
        topic: &'static str,
        /// Control step that the message belongs to.
        step: u64,
        /// What the decoder says.
        #[source]
        source: DecodeError,
    },
}

impl BagError {
    pub(crate) fn io(action: &'static str, path: &Path) -> impl FnOnce(io::Error) -> Self {
        move |source| Self::Io { action, path: path.into(), source }
    }

    pub(crate) fn write(path: &Path) -> impl FnOnce(McapError) -> Self {
        move |source| Self::Write { path: path.into(), source: Box::new(source) }
    }

    pub(crate) fn not_a_bag(path: &Path, reason: impl Into<String>) -> Self {
        Self::NotABag { path: path.into(), reason: reason.into() }
    }

    pub(crate) fn damaged(path: &Path, offset: u64, reason: impl ToString) -> Self {
        Self::Damaged { path: path.into(), offset, reason: reason.to_string() }
    }
}
