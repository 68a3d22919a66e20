//! What a policy sees: measured from rows alone, noise included, and laid out as the published flat vectors.
//!
//! Nothing here runs by itself: each term is measured when somebody asks for it.

mod contact;
mod foot_force;
mod kinematics;
mod privileged;
mod proprioception;
mod standard;
mod table;

pub use contact::{hand_force, limb_force};
pub use foot_force::{FOOT_FORCE_HEIGHT, foot_force_estimate};
pub use kinematics::world_from_link;
pub use privileged::{ClimbPrivileged, Privileged, flat_privileged};
pub use proprioception::{NoiseSeed, Observer, Proprioception};
pub use standard::{StandardTerms, flat_standard};
pub use table::{FEATURES, ObservationTerm, Signal, observation_length, observation_terms};
