use std::io;
use std::path::PathBuf;

use thiserror::Error;

#[derive(Debug, Error)]
pub enum AccessError {
    #[error("cannot read {}; `fiatlux keys --out DIR` creates such files", path.display())]
    Read { path: PathBuf, source: io::Error },
    #[error("cannot write {}; check the folder, its permissions and the free disk space", path.display())]
    Write { path: PathBuf, source: io::Error },
    #[error("{} exists and will not be overwritten; move it away or name another file", path.display())]
    Exists { path: PathBuf },
    #[error("{} is a device or a folder, not a file of keys; name a file that `fiatlux keys --out DIR` made", path.display())]
    Kind { path: PathBuf },
    /// Others on this machine can read or change a secret.
    #[error(
        "{} has mode {mode:04o}, so others can read the secret in it; run `chmod 600 {}`, and make a new one if they may have \
         read it. A secret that an orchestrator mounts may be root's with mode 0440; on a disk without modes (Windows' in WSL, \
         some network shares) set FIATLUX_ANY_MODE=1",
        path.display(), path.display()
    )]
    Exposed { path: PathBuf, mode: u32 },
    #[error("{}:{line}: {field}: {problem}; {remedy}", path.display())]
    Line {
        path: PathBuf,
        line: usize,
        field: &'static str,
        /// Never repeats a secret.
        problem: String,
        remedy: &'static str,
    },
    #[error("the system's random source failed; a key needs random numbers")]
    Random(#[source] getrandom::Error),
}

/// A text is not a key or a token. The caller adds file and line.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("{field}: {problem}; {remedy}")]
pub struct FormatError {
    pub field: &'static str,
    pub problem: String,
    pub remedy: &'static str,
}

impl FormatError {
    pub(crate) fn new(field: &'static str, problem: impl Into<String>, remedy: &'static str) -> Self {
        Self { field, problem: problem.into(), remedy }
    }

    pub(crate) fn at(self, path: &std::path::Path, line: usize) -> AccessError {
        let Self { field, problem, remedy } = self;
        AccessError::Line { path: path.to_owned(), line, field, problem, remedy }
    }
}
