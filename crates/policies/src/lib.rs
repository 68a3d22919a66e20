//! The built-in policies, one in each file, and the registry that makes policies by name.

mod body;
mod body_motion;
mod climb;
mod climber;
mod entry;
mod expert;
mod foreign;
mod gait;
mod hands;
mod hold;
mod labeller;
mod ladder;
mod random;
mod registry;
mod replay;
mod see;
mod stand;
mod vla;
mod walk;
mod wbc;
mod whole_body;
mod zero;

use std::path::Path;

pub use climb::Climb;
pub use climber::{ClimbCommand, Climber};
pub use entry::Entry;
pub use expert::{Expert, Label};
pub use foreign::{Gear, Sonic};
pub use hands::Hands;
pub use hold::Hold;
pub use labeller::Labeller;
pub use ladder::Ladder;
pub use random::Random;
pub use registry::{Policies, relayed};
pub use see::See;
pub use stand::Stand;
pub use vla::{Answer, ProbeReport, Vla, VlaArgs, VlaSource};
pub use walk::Walk;
pub use wbc::Wbc;
pub use whole_body::WholeBody;
pub use zero::Zero;

/// The path of the bag in a name such as `replay:BAG`; `None` for other policies.
pub fn replayed_bag(name: &str) -> Option<&Path> {
    name.strip_prefix("replay:").filter(|path| !path.is_empty()).map(Path::new)
}

#[cfg(test)]
mod tests;
