//! One sensor a file: `build.rs` lists the files of the folder.

include!(concat!(env!("OUT_DIR"), "/modules.rs"));

pub use hand_contact::hand_force;
pub use limb_contact::limb_force;
pub use privileged::{ClimbPrivileged, Privileged};
