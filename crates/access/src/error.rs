//! Why a key or a token cannot be used.

use std::io;
use std::path::PathBuf;

use thiserror::Error;

/// Why a key or a token cannot be used.
#[derive(Debug, Error)]
pub enum AccessError {
    /// The file cannot be read.
    #[error("cannot read {}; `fiatlux keys --out DIR` makes such files", path.display())]
    Read {
        /// Path of the file that cannot be read.
        path: PathBuf,
        /// What the operating system says.
        #[source]
        source: io::Error,
    },
    /// The file cannot be made.
    #[error("cannot write {}; check the folder, its permissions and the space that is left", path.display())]
    Write {
        /// Path of the file that cannot be made.
        path: PathBuf,
        /// What the operating system says.
        #[source]
        source: io::Error,
    },
    /// A file of that name exists; keys are never overwritten.
    #[error("{} exists and is not overwritten; move it away or name another file", path.display())]
    Exists {
        /// Path that is already taken.
        path: PathBuf,
    },
    /// Others on this machine can read or change a secret.
    #[error("{} has mode {mode:04o}, so others can read the secret in it; run `chmod 600 {}`, and make a new one if they may have read it", path.display(), path.display())]
    Exposed {
        /// Path of the exposed file.
        path: PathBuf,
        /// Its permission bits as the system gives them, such as 0o644.
        mode: u32,
    },
    /// A line of a file is wrong.
    #[error("{}:{line}: {field}: {problem}; {remedy}", path.display())]
    Line {
        /// Path of the file, for the message.
        path: PathBuf,
        /// Number of the line, from 1.
        line: usize,
        /// What of the line is wrong.
        field: &'static str,
        /// What is wrong with it. Never repeats a secret.
        problem: String,
        /// How it is written.
        remedy: &'static str,
    },
    /// The system has no random numbers to give.
    #[error("the system gives no random numbers; a key needs them")]
    Random(#[source] getrandom::Error),
}

/// What is wrong with a text that should be a key or a token, without its place.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("{field}: {problem}; {remedy}")]
pub struct FormatError {
    /// What of the text is wrong.
    pub field: &'static str,
    /// What is wrong with it. Never repeats a secret.
    pub problem: String,
    /// How it is written.
    pub remedy: &'static str,
}

impl FormatError {
    pub(crate) fn new(field: &'static str, problem: impl Into<String>, remedy: &'static str) -> Self {
        Self { field, problem: problem.into(), remedy }
    }

    /// In that line of a file.
    pub(crate) fn at(self, path: &std::path::Path, line: usize) -> AccessError {
        let Self { field, problem, remedy } = self;
        AccessError::Line { path: path.to_owned(), line, field, problem, remedy }
    }
}
