//! Why a controller is refused.

use std::path::PathBuf;

use thiserror::Error;

/// Why a controller cannot be loaded, does not fit, or cannot go on.
#[derive(Debug, Error)]
pub enum WbcError {
    /// The file cannot be read.
    #[error("cannot read the controller {}", path.display())]
    Read {
        /// As it was given.
        path: PathBuf,
        /// The system's error.
        #[source]
        source: std::io::Error,
    },
    /// The file is a checkpoint of a training run.
    #[error(
        "{0} is a checkpoint, not a controller; export it: python -m fiatlux.train export {0} {1}",
        path.display(), path.with_extension("safetensors").display()
    )]
    Checkpoint {
        /// As it was given.
        path: PathBuf,
    },
    /// The file is not a safetensors file, or lacks a tensor of its contract.
    #[error("the controller's file is damaged; export it again")]
    File(#[from] fiatlux_safetensors::SafetensorsError),
    /// The file does not say what it was made for.
    #[error("the controller's file has no contract; export it with this version")]
    NoContract,
    /// A layer without numbers, too wide, or a hidden one without pairs.
    #[error(
        "the controller has a layer of {size} numbers, and they have 1 to {most}, hidden ones an even number; export it again"
    )]
    Layer {
        /// Numbers of the layer, as its contract says.
        size: usize,
        /// The most that is taken.
        most: usize,
    },
    /// The contract cannot be read.
    #[error("the controller's contract cannot be read; export it with this version")]
    Contract(#[source] serde_json::Error),
    /// It was made for something else.
    #[error("the controller was made for {what} {found}, and this is {expected}; train or export one for it")]
    Unfit {
        /// Which property differs, with its unit where it has one.
        what: String,
        /// The value in the contract.
        found: String,
        /// The value in this program, or in the session.
        expected: String,
    },
    /// A tensor holds NaN or infinity.
    #[error("tensor '{0}' is not finite; the training has failed, choose another checkpoint")]
    Weights(String),
    /// The network does not give what it gave when it was exported.
    #[error("the network differs from its export by {0:.2e}; export it again with this version")]
    Check(f32),
    /// The controller for standing does not fit the joints, or refuses an observation.
    #[error("the controller cannot stand")]
    Balance(#[from] crate::BalanceError),
    /// An observation lacks a term or has NaN in it.
    #[error("the controller needs {term}, which {problem}")]
    Sensed {
        /// Name of the term.
        term: &'static str,
        /// Fault of the value.
        problem: &'static str,
    },
    /// Arms whose weight cannot be compensated; says why.
    #[error("cannot hold the arms: {0}")]
    Arms(String),
    /// An angle for an arm's joint is NaN or infinite.
    #[error("the angle of {0} is not finite")]
    Angle(String),
    /// A pose for a hand is NaN or infinite.
    #[error("the pose for the {0} hand, or its firmness, is not finite")]
    Goal(&'static str),
    /// A command that is not finite or out of range.
    #[error("command {field} is {value}, outside of {low} to {high}; command something within")]
    Command {
        /// Name of the number, such as `vx`.
        field: &'static str,
        /// The value that was commanded.
        value: f64,
        /// The least value that is taken.
        low: f64,
        /// The greatest value that is taken.
        high: f64,
    },
}
