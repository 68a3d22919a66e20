use std::path::PathBuf;

use thiserror::Error;

/// Why a controller of others cannot be loaded, does not fit, or cannot go on.
#[derive(Debug, Error)]
pub enum ForeignError {
    /// A file of the controller is not there.
    #[error("there is no {}; weights are not shipped: get it from {source_of}", path.display())]
    Missing {
        /// Where it was looked for.
        path: PathBuf,
        /// Where its makers publish it.
        source_of: &'static str,
    },
    /// A file cannot be read.
    #[error("cannot read {}; check that it is a file and may be read", path.display())]
    Read {
        /// As it was given.
        path: PathBuf,
        /// What the system says.
        #[source]
        source: std::io::Error,
    },
    /// A file is larger than any that is taken.
    #[error("{} has more than {most} bytes; name the controller's own file", path.display())]
    FileSize {
        /// As it was given.
        path: PathBuf,
        /// The largest size.
        most: u64,
    },
    /// A file that Git LFS did not fetch.
    #[error("{} is a pointer of Git LFS and not the network; run `git lfs pull` where it was cloned", path.display())]
    Pointer {
        /// As it was given.
        path: PathBuf,
    },
    /// A file is not the one that its list of digests names.
    #[error("{} has the SHA-256 {found}, and {expected} was asked for; get the right file, or correct the digest", path.display())]
    Digest {
        /// As it was given.
        path: PathBuf,
        /// Of the file, hexadecimal.
        found: String,
        /// As it was asked for.
        expected: String,
    },
    /// A list of digests cannot be read.
    #[error("{} line {line}: expected 64 hexadecimal digits and a name, as sha256sum writes them", path.display())]
    DigestList {
        /// The list.
        path: PathBuf,
        /// Counted from 1.
        line: usize,
    },
    /// The bytes are not a network that can be run.
    #[error("cannot load {} as an ONNX network: {problem}; export it again, in one file, with operators up to set 18", path.display())]
    Onnx {
        /// As it was given.
        path: PathBuf,
        /// What the loader says.
        problem: String,
    },
    /// The network has other inputs or outputs.
    #[error("{}: expected {side} {expected}, found {found}; this is another network's file", path.display())]
    Shape {
        /// As it was given.
        path: PathBuf,
        /// Input or output.
        side: &'static str,
        /// Type and shape.
        expected: String,
        /// Type and shape.
        found: String,
    },
    /// A weight is NaN or infinite.
    #[error("{}: the constant '{tensor}' is not finite at index {index}; use another checkpoint", path.display())]
    Weights {
        /// As it was given.
        path: PathBuf,
        /// Its name in the file.
        tensor: String,
        /// Of the number, counted through the tensor.
        index: usize,
    },
    /// The session differs from what the controller was made for.
    #[error("{controller} was made for {what} {expected}, and the session has {found}; {remedy}")]
    Unfit {
        /// Name of the controller.
        controller: &'static str,
        /// What differs.
        what: String,
        /// Of the controller.
        expected: String,
        /// Of the session.
        found: String,
        /// What to do.
        remedy: String,
    },
    /// The robot of this version cannot be read.
    #[error("the robot that the controller was made for cannot be read")]
    Robot(#[from] fiatlux_robot::RobotError),
    /// An observation lacks a term or has NaN in it.
    #[error("{controller} needs {term}, which {problem}")]
    Sensed {
        /// Name of the controller.
        controller: &'static str,
        /// Name of the term.
        term: &'static str,
        /// What is wrong with it.
        problem: &'static str,
    },
    /// A command that is not finite.
    #[error("command {field} is {value}; command a finite number")]
    Command {
        /// Its name.
        field: &'static str,
        /// As commanded.
        value: f64,
    },
    /// A token that no model gives.
    #[error("number {index} of the token is {value}; a token has 64 numbers from -{most} to {most}")]
    Token {
        /// Which of the 64.
        index: usize,
        /// As given.
        value: f32,
        /// The largest size.
        most: f32,
    },
    /// Not as many numbers as a token has.
    #[error("a token has 64 numbers, and {found} were given; give all of one")]
    Width {
        /// How many there were.
        found: usize,
    },
    /// A file of tokens cannot be used.
    #[error("{} line {line}: {problem}; write 64 numbers a line, one line a control step of 20 ms, as numpy.savetxt does", path.display())]
    Tokens {
        /// The file.
        path: PathBuf,
        /// Counted from 1.
        line: usize,
        /// What is wrong with it.
        problem: String,
    },
    /// A network failed in a step.
    #[error("{controller}: its network failed: {problem}; check the observation, or use another checkpoint")]
    Run {
        /// Name of the controller.
        controller: &'static str,
        /// What went wrong.
        problem: String,
    },
}
