//! The built-in policies, one in each file.

mod body;
mod foreign;
mod hold;
mod random;
mod replay;
mod stand;
mod vla;
mod walk;
mod wbc;
mod whole_body;
mod zero;

use std::path::Path;

use fiatlux_client::{Policy, PolicyError};

pub use foreign::{Gear, Sonic};
pub use hold::Hold;
pub use random::Random;
pub use replay::Replay;
pub use stand::Stand;
pub use vla::{Answer, Probed, Vla, VlaArgs, VlaSource};
pub use walk::Walk;
pub use wbc::Wbc;
pub use whole_body::WholeBody;
pub use zero::Zero;

/// Names of the policies, each with a description for the command line.
pub const NAMES: [(&str, &str); 10] = [
    ("zero", "all actions 0: every joint goes to its angle of the standing posture, on which the robot soon falls"),
    ("random", "uniform in [-1, 1], drawn from the session's seed and the episode's index"),
    ("hold", "keeps the posture of the start"),
    ("stand", "keeps the robot upright on level ground by closing a loop over its centre of mass"),
    (
        "wbc",
        "walks, turns and bends on one command, such as wbc:vx=0.4,wz=0.2 (vx -0.5 to 1.0 m/s, vy -0.4 to 0.4 m/s, wz -1.0 to \
         1.0 rad/s, height 0.65 to 0.79 m, roll, pitch, yaw of the torso in rad); the arms keep the posture of the start; \
         wbc:FILE,vx=0.4 with weights of your own",
    ),
    (
        "walk",
        "walks to the crate (S05), the fresh bulb (S07) or the ladder (S09) by their exact poses, and stands there; \
         walk:FILE with weights of your own",
    ),
    (
        "vla",
        "plays the chunks of a model server: --dialect and --model say which, --map what its keys are on this robot",
    ),
    (
        "gear:DIR",
        "GEAR's decoupled whole-body controller from the ONNX files in DIR, on one command: gear:DIR,vx=0.4; \
         reading=lerobot for the other reading of its sources, gains=any to play on other gains",
    ),
    (
        "sonic:DIR",
        "the decoder of GEAR-SONIC from the ONNX file in DIR, on a recorded sequence of tokens: sonic:DIR,token=FILE",
    ),
    ("replay:BAG", "sends the actions of a recorded episode again, exactly as they were received"),
];

/// Makes a policy by its name: one of [`NAMES`] except `vla`. `BAG` is the path of an .mcap file, and `DIR` that of a
/// folder, without a comma. [`VlaArgs`] makes `vla`.
///
/// # Errors
/// [`PolicyError::Unknown`], or a bag or a controller that cannot be loaded.
pub fn by_name(name: &str) -> Result<Box<dyn Policy>, PolicyError> {
    match name {
        "zero" => Ok(Box::new(Zero::default())),
        "random" => Ok(Box::new(Random::default())),
        "hold" => Ok(Box::new(Hold::default())),
        "stand" => Ok(Box::new(Stand::default())),
        "walk" => Ok(Box::new(Walk::new("")?)),
        "wbc" => Ok(Box::new(Wbc::new("")?)),
        other if other.len() > "walk:".len() && other.starts_with("walk:") => {
            Ok(Box::new(Walk::new(&other["walk:".len()..])?))
        }
        other if other.starts_with("wbc:") => Ok(Box::new(Wbc::new(&other["wbc:".len()..])?)),
        "vla" => {
            let reason = "it needs a model server; give --dialect and --model".into();
            Err(PolicyError::Unfit { policy: "vla", reason })
        }
        other if other.len() > "gear:".len() && other.starts_with("gear:") => {
            Ok(Box::new(Gear::new(&other["gear:".len()..])?))
        }
        other if other.len() > "sonic:".len() && other.starts_with("sonic:") => {
            Ok(Box::new(Sonic::new(&other["sonic:".len()..])?))
        }
        other => match replayed_bag(other) {
            Some(path) => Ok(Box::new(Replay::open(path)?)),
            None => {
                Err(PolicyError::Unknown { name: other.to_string(), known: NAMES.map(|(name, _)| name).join(", ") })
            }
        },
    }
}

/// The path of the bag in a name such as `replay:BAG`; `None` for other policies.
pub fn replayed_bag(name: &str) -> Option<&Path> {
    name.strip_prefix("replay:").filter(|path| !path.is_empty()).map(Path::new)
}

#[cfg(test)]
mod tests;
