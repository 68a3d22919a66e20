//! Parts that the skills of a robot share, below the policies that play them: paths on the floor that keep clear of what stands there
//! ([`Map`]), velocities that bring a robot along them ([`walker`]), changes at a bounded rate ([`towards`]),
//! arms that bring the hands to poses ([`Reach`]), fingers that close around things ([`grip`]), and the
//! phases that a skill goes through ([`phases`]).

pub mod grip;
pub mod path;
pub mod phases;
mod reach;
pub mod walker;

pub use path::Map;
pub use reach::{HandGoal, Reach, ReachOptions};
pub use walker::{GAIN, Slew, Steps, heading, steps_to, towards};
