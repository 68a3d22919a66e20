//! Errors of keys, tokens and their files.

use std::io;
use std::path::PathBuf;

use thiserror::Error;

/// Why a key or a token cannot be used.
#[derive(Debug, Error)]
pub enum AccessError {
    /// The file cannot be read.
    #[error("cannot read {}; `fiatlux keys --out DIR` creates such files", path.display())]
    Read {
        /// Path of the file that cannot be read.
        path: PathBuf,
        /// The operating system's error.
        #[source]
        source: io::Error,
    },
    /// The file cannot be written.
    #[error("cannot write {}; check the folder, its permissions and the free disk space", path.display())]
    Write {
        /// Path of the file that cannot be written.
        path: PathBuf,
        /// The operating system's error.
        #[source]
        source: io::Error,
    },
    /// The file exists already; keys are never overwritten.
    #[error("{} exists and will not be overwritten; move it away or name another file", path.display())]
    Exists { path: PathBuf },
    /// Others on this machine can read or change a secret.
    #[error("{} has mode {mode:04o}, so others can read the secret in it; run `chmod 600 {}`, and make a new one if they may have read it", path.display(), path.display())]
    Exposed {
        path: PathBuf,
        /// Permission bits of the file, such as 0o644.
        mode: u32,
    },
    /// A line of a file is wrong.
    #[error("{}:{line}: {field}: {problem}; {remedy}", path.display())]
    Line {
        /// Path of the file, for the message.
        path: PathBuf,
        /// Number of the line, from 1.
        line: usize,
        /// Which part of the line is wrong.
        field: &'static str,
        /// What is wrong with it; never repeats a secret.
        problem: String,
        remedy: &'static str,
    },
    /// The system's random source failed, so no key can be made.
    #[error("the system's random source failed; a key needs random numbers")]
    Random(#[source] getrandom::Error),
}

/// What is wrong with a text that should be a key or a token, without the file and line it comes from.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("{field}: {problem}; {remedy}")]
pub struct FormatError {
    /// Which part of the text is wrong.
    pub field: &'static str,
    /// What is wrong with it; never repeats a secret.
    pub problem: String,
    /// How to write it correctly.
    pub remedy: &'static str,
}

impl FormatError {
    pub(crate) fn new(field: &'static str, problem: impl Into<String>, remedy: &'static str) -> Self {
        Self { field, problem: problem.into(), remedy }
    }

    /// The same error with a file and a line.
    pub(crate) fn at(self, path: &std::path::Path, line: usize) -> AccessError {
        let Self { field, problem, remedy } = self;
        AccessError::Line { path: path.to_owned(), line, field, problem, remedy }
    }
}
