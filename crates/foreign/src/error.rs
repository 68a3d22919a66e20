use std::path::PathBuf;

use thiserror::Error;

#[derive(Debug, Error)]
pub enum ForeignError {
    #[error("cannot find {}; weights are not shipped: download it from {source_of}", path.display())]
    Missing { path: PathBuf, source_of: &'static str },
    #[error("cannot read {}; check that it is a file and its permissions", path.display())]
    Read { path: PathBuf, source: std::io::Error },
    #[error("{} has more than {most} bytes; name the controller's own file", path.display())]
    FileSize { path: PathBuf, most: u64 },
    #[error("{} is a Git LFS pointer and not the network; run `git lfs pull` where it was cloned", path.display())]
    Pointer { path: PathBuf },
    #[error("{} has SHA-256 {found}; expected {expected}: get the right file, or correct the digest", path.display())]
    Digest { path: PathBuf, found: String, expected: String },
    #[error("{} line {line}: expected 64 hexadecimal digits and a name, as sha256sum writes them", path.display())]
    DigestList { path: PathBuf, line: usize },
    #[error("cannot load {} as an ONNX network: {problem}; export it again, in one file and in f32, with operators that docs/controllers.md lists", path.display())]
    Onnx { path: PathBuf, problem: String },
    #[error("{}: expected {side} {expected}, found {found}; this is another network's file", path.display())]
    Shape {
        path: PathBuf,
        /// Which side differs: `input` or `output`.
        side: &'static str,
        expected: String,
        found: String,
    },
    #[error("{}: the constant '{tensor}' is not finite at index {index}; use another checkpoint", path.display())]
    Weights { path: PathBuf, tensor: String, index: usize },
    #[error("{controller} was made for {what} {expected}, but the session has {found}; {remedy}")]
    Unfit { controller: &'static str, what: String, expected: String, found: String, remedy: String },
    #[error("cannot read the robot that the controller was made for")]
    Robot(#[from] fiatlux_robot::RobotError),
    #[error("{controller} needs {term}, which {problem}")]
    Sensed {
        controller: &'static str,
        term: &'static str,
        /// Follows "which" in the message.
        problem: &'static str,
    },
    #[error("command {field} is {value}; use a finite number")]
    Command { field: &'static str, value: f64 },
    #[error("number {index} of the token is {value}; a token has 64 numbers from -{most} to {most}")]
    Token { index: usize, value: f32, most: f32 },
    #[error("found {found} numbers; a token needs 64")]
    Width { found: usize },
    #[error("{} line {line}: {problem}; write 64 numbers a line, one line a control step of 20 ms, as numpy.savetxt does", path.display())]
    Tokens { path: PathBuf, line: usize, problem: String },
    #[error("the network of {controller} failed: {problem}; check the observation, or use another checkpoint")]
    Run { controller: &'static str, problem: String },
}
