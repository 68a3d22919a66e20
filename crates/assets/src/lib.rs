//! Feasibility trials of objects ([`Object`](fiatlux_world::Object)) in the engine: whether they settle, fall, plug in, bear a
//! load, fit the room and turn in their joints.
//!
//! One trial is one fresh simulation. The paper states what is tried and how often, but neither heights nor forces nor bounds:
//! those are constants of the trials' modules. [`trials()`] lists the trials of some objects and runs them.

mod error;
mod rig;
pub mod trials;

pub use error::TrialError;
pub use trials::{Check, Trial, trials};
