use std::io;
use std::path::{Path, PathBuf};

use fiatlux_proto::v3::Version;
use fiatlux_proto::{DecodeError, PROTOCOL};
use mcap::McapError;
use thiserror::Error;

#[derive(Debug, Error)]
pub enum BagError {
    #[error("cannot {action} {path}; check that it exists, its permissions, and the free disk space")]
    Io { action: &'static str, path: PathBuf, source: io::Error },
    #[error("{path} exists already; move it away or choose another name")]
    Exists { path: PathBuf },
    #[error("cannot write {path}; free some space and record the episode again")]
    Write { path: PathBuf, source: Box<McapError> },
    #[error("bags have no topic {topic}; use one of fiatlux_bag::topic")]
    Topic { topic: String },
    #[error("the {what} does not read back as it was given; make its numbers finite")]
    Values { what: &'static str },
    #[error("{path} is not a bag: {reason}; name an .mcap file that a recorder wrote")]
    NotABag { path: PathBuf, reason: String },
    #[error(
        "{path} is of protocol {found}, this program reads {PROTOCOL}; use the programs of its own version, or \
         record the episode again"
    )]
    Version { path: PathBuf, found: Version },
    /// The reader's [`Patience`](crate::Patience) has ended.
    #[error("{path} takes longer to read than the limit; it holds far more than an episode")]
    Slow { path: PathBuf },
    #[error(
        "{path} was changed after it was recorded, or damaged on the way, at byte {offset}: {reason}; ask for the file \
         again, or record the episode again"
    )]
    Damaged { path: PathBuf, offset: u64, reason: String },
    /// Two copies of the same data disagree.
    #[error("{path} was changed: {what}; record the episode again")]
    Disagrees { path: PathBuf, what: String },
    #[error("{path} cannot be made {form}: {reason}")]
    Form { path: PathBuf, form: &'static str, reason: String },
    /// A bag whose rows, simulated, are not those of its digest.
    #[error("the rows of {path} cannot be simulated: {reason}")]
    Simulated { path: PathBuf, reason: String },
    /// This program cannot simulate it, which says nothing against the bag.
    #[error("the rows of {path} cannot be simulated here: {reason}; or use the full bag")]
    Unable { path: PathBuf, reason: String },
    /// The machine cannot keep the rows of a thin bag while they are read.
    #[error(
        "there is no room for the simulated rows of {path}: {reason}; free some space for temporary files, or name another \
         folder for them by TMPDIR"
    )]
    NoRoom { path: PathBuf, reason: String },
    #[error("{path}: step {step} of {topic} cannot be read; record the episode again with this version")]
    Message { path: PathBuf, topic: &'static str, step: u64, source: DecodeError },
}

impl BagError {
    /// True if the machine failed, not the bag: its disk, or a limit of it. Another try may succeed.
    pub fn is_of_machine(&self) -> bool {
        match self {
            Self::Io { source, .. } => source.kind() != io::ErrorKind::NotFound,
            Self::Write { .. } | Self::NoRoom { .. } => true,
            _ => false,
        }
    }

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
