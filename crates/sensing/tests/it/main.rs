//! Sensors, and the quantities that vary between episodes.
#![allow(clippy::unwrap_used, missing_docs)]

mod channels;
mod chest_camera;
mod common;
mod foot_force;
mod lidar;
mod observations;
mod randomization;
mod registry;
mod wrist_cameras;
