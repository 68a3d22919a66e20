//! One sensor a file.

pub(crate) mod camera;
pub(crate) mod chest_camera;
pub(crate) mod features;
pub(crate) mod flat;
pub(crate) mod hand_contact;
pub(crate) mod last_action;
pub(crate) mod lidar;
pub(crate) mod limb_contact;
pub(crate) mod privileged;
pub(crate) mod proprioception;
pub(crate) mod verdict;

pub use hand_contact::hand_force;
pub use limb_contact::limb_force;
pub use privileged::{ClimbPrivileged, Privileged};
