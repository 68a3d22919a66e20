//! Parts that the skills of a robot share, below the policies that play them: paths on the floor that keep clear of what stands there
//! ([`Map`]), velocities that bring a robot along them ([`walker`]), and changes at a bounded rate ([`towards`]).

pub mod path;
pub mod walker;

pub use path::Map;
pub use walker::{GAIN, Slew, Steps, heading, steps_to, towards};
