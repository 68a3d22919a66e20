//! The policies that come with the program, one a file.

mod hold;
mod random;
mod replay;
mod stand;
mod zero;

use std::path::Path;

use crate::{Policy, PolicyError};

pub use hold::Hold;
pub use random::Random;
pub use replay::Replay;
pub use stand::Stand;
pub use zero::Zero;

/// Names of the policies and what they do.
pub const NAMES: [(&str, &str); 5] = [
    ("zero", "all actions 0: every joint goes to its angle of the standing posture, on which the robot soon falls"),
    ("random", "uniform in [-1, 1], drawn from the session's seed and the episode's index"),
    ("hold", "keeps the posture of the start"),
    ("stand", "keeps the robot upright on level ground by closing a loop over its centre of mass"),
    ("replay:BAG", "sends the actions of a recorded episode once more, exactly as they were received"),
];

/// Makes a policy by its name: one of [`NAMES`], where `BAG` is the path of an .mcap file.
///
/// # Errors
/// [`PolicyError::Unknown`], or a bag that cannot be read.
pub fn by_name(name: &str) -> Result<Box<dyn Policy>, PolicyError> {
    match name {
        "zero" => Ok(Box::new(Zero::default())),
        "random" => Ok(Box::new(Random::default())),
        "hold" => Ok(Box::new(Hold::default())),
        "stand" => Ok(Box::new(Stand::default())),
        other => match replayed_bag(other) {
            Some(path) => Ok(Box::new(Replay::open(path)?)),
            None => {
                Err(PolicyError::Unknown { name: other.to_string(), known: NAMES.map(|(name, _)| name).join(", ") })
            }
        },
    }
}

/// The bag of a policy that is named `replay:BAG`.
pub fn replayed_bag(name: &str) -> Option<&Path> {
    name.strip_prefix("replay:").filter(|path| !path.is_empty()).map(Path::new)
}

#[cfg(test)]
mod tests;
