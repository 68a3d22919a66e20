//! Pictures, and the meshes that a user brings.
#![allow(clippy::unwrap_used, missing_docs)]

mod frames;
mod framing;
mod looks;
mod object;
mod robot_meshes;
mod variation;
