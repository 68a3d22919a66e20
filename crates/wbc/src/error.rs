//! Why a controller is refused.

use std::path::PathBuf;

use thiserror::Error;

/// Why a controller cannot be loaded, does not fit, or cannot go on.
#[derive(Debug, Error)]
#[allow(missing_docs)] // The messages say it.
pub enum WbcError {
    #[error("cannot read the controller {}", path.display())]
    Read { path: PathBuf, source: std::io::Error },
    #[error(
        "{0} is a checkpoint, not a controller; export it: python -m fiatlux.train export {0} {1}",
        path.display(), path.with_extension("safetensors").display()
    )]
    Checkpoint { path: PathBuf },
    #[error("the controller's file is damaged; export it again")]
    File(#[from] fiatlux_safetensors::SafetensorsError),
    #[error("the controller's file has no contract; export it with this version")]
    NoContract,
    #[error(
        "the controller has a layer of {size} numbers, and they have 1 to {most}, hidden ones an even number; export it again"
    )]
    Layer { size: usize, most: usize },
    #[error("the controller's contract cannot be read; export it with this version")]
    Contract(#[source] serde_json::Error),
    #[error("the controller was made for {what} {found}, and this is {expected}; train or export one for it")]
    Unfit { what: String, found: String, expected: String },
    #[error("tensor '{0}' is not finite; the training has failed, choose another checkpoint")]
    Weights(String),
    #[error("the network differs from its export by {0:.2e}; export it again with this version")]
    Check(f32),
    #[error("the controller cannot stand")]
    Balance(#[from] crate::BalanceError),
    #[error("the controller needs {term}, which {problem}")]
    Sensed { term: &'static str, problem: &'static str },
    #[error("cannot hold the arms: {0}")]
    Arms(String),
    #[error("the angle of {0} is not finite")]
    Angle(String),
    #[error("the pose for the {0} hand, or its firmness, is not finite")]
    Goal(&'static str),
    #[error("command {field} is {value}, outside of {low} to {high}; command something within")]
    Command { field: &'static str, value: f64, low: f64, high: f64 },
}
