use std::path::PathBuf;

use thiserror::Error;

/// Why a foreign controller cannot be loaded, does not match the session, or cannot continue.
#[derive(Debug, Error)]
pub enum ForeignError {
    /// A file of the controller does not exist.
    #[error("cannot find {}; weights are not shipped: download it from {source_of}", path.display())]
    Missing { path: PathBuf, source_of: &'static str },
    /// A file cannot be opened or read.
    #[error("cannot read {}; check that it is a file and its permissions", path.display())]
    Read {
        path: PathBuf,
        /// The system's error, which says why.
        #[source]
        source: std::io::Error,
    },
    /// A file is too large to be a controller's.
    #[error("{} has more than {most} bytes; name the controller's own file", path.display())]
    FileSize {
        path: PathBuf,
        /// Largest size that is read, bytes.
        most: u64,
    },
    /// A file is a Git LFS pointer: its content was not fetched.
    #[error("{} is a Git LFS pointer and not the network; run `git lfs pull` where it was cloned", path.display())]
    Pointer { path: PathBuf },
    /// The digest of a file is not the expected one.
    #[error("{} has SHA-256 {found}; expected {expected}: get the right file, or correct the digest", path.display())]
    Digest {
        path: PathBuf,
        /// SHA-256 of the file, hexadecimal.
        found: String,
        /// SHA-256 that the list or the caller names.
        expected: String,
    },
    /// A list of digests cannot be parsed.
    #[error("{} line {line}: expected 64 hexadecimal digits and a name, as sha256sum writes them", path.display())]
    DigestList {
        path: PathBuf,
        /// Number of the line, from 1.
        line: usize,
    },
    /// The bytes are not a network that can be run.
    #[error("cannot load {} as an ONNX network: {problem}; export it again, in one file and in f32, with operators that docs/controllers.md lists", path.display())]
    Onnx { path: PathBuf, problem: String },
    /// The network has inputs or outputs of another type or shape.
    #[error("{}: expected {side} {expected}, found {found}; this is another network's file", path.display())]
    Shape {
        path: PathBuf,
        /// Which side differs: `input` or `output`.
        side: &'static str,
        /// Type and shape that the controller needs.
        expected: String,
        found: String,
    },
    /// A weight is NaN or infinite.
    #[error("{}: the constant '{tensor}' is not finite at index {index}; use another checkpoint", path.display())]
    Weights {
        path: PathBuf,
        /// Name of the tensor in the file.
        tensor: String,
        /// Index of the number in the flat tensor.
        index: usize,
    },
    /// The session is not what the controller was made for.
    #[error("{controller} was made for {what} {expected}, but the session has {found}; {remedy}")]
    Unfit {
        controller: &'static str,
        what: String,
        /// The value that the controller was made for.
        expected: String,
        found: String,
        remedy: String,
    },
    /// The robot in this version's files cannot be loaded.
    #[error("cannot read the robot that the controller was made for")]
    Robot(#[from] fiatlux_robot::RobotError),
    /// An observation lacks a term, or a term is not finite.
    #[error("{controller} needs {term}, which {problem}")]
    Sensed {
        controller: &'static str,
        term: &'static str,
        /// What is wrong with it, to follow "which".
        problem: &'static str,
    },
    /// A field of a command is not finite.
    #[error("command {field} is {value}; use a finite number")]
    Command { field: &'static str, value: f64 },
    /// A value of a token is NaN or too large.
    #[error("number {index} of the token is {value}; a token has 64 numbers from -{most} to {most}")]
    Token {
        /// Index in the token, from 0.
        index: usize,
        value: f32,
        /// Largest allowed absolute value.
        most: f32,
    },
    /// A token has the wrong number of values.
    #[error("found {found} numbers; a token needs 64")]
    Width { found: usize },
    /// A file of tokens cannot be parsed.
    #[error("{} line {line}: {problem}; write 64 numbers a line, one line a control step of 20 ms, as numpy.savetxt does", path.display())]
    Tokens {
        path: PathBuf,
        /// Number of the line, from 1.
        line: usize,
        problem: String,
    },
    /// A network fails, or gives numbers that are not finite, during a step.
    #[error("the network of {controller} failed: {problem}; check the observation, or use another checkpoint")]
    Run { controller: &'static str, problem: String },
}
