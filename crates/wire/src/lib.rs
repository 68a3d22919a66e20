//! Messages to our types and back: the one place where protobuf meets the rulebook and the world.
//!
//! A message that arrives is hostile until it is read here: what is missing, has a wrong length or a number that is not
//! finite is a [`WireError`] that names the field. What is read comes back bit for bit when it is written again.
//!
//! ```
//! use fiatlux_rules::{RobotLayout, Row};
//! use fiatlux_wire::{WireError, read_row, state_message};
//!
//! let layout = RobotLayout { joints: 29, hand_bodies_per_side: 17 };
//! let mut row = Row::zeros(layout);
//! row.joint_position[3] = 0.2;
//! let mut state = state_message(&row);
//! assert_eq!(read_row(&state, layout)?, row);
//!
//! state.joint_velocity.pop();
//! let error = read_row(&state, layout).unwrap_err();
//! assert_eq!(error.to_string(), "joint_velocity has 28 numbers instead of 29");
//! # Ok::<(), WireError>(())
//! ```
#![allow(missing_docs)] // Used in this repository alone.
mod end;
mod error;
mod geometry;
mod header;
mod known;
mod pose;
mod request;
mod row;
mod task;

#[cfg(feature = "world")]
mod domain_sample;
#[cfg(feature = "world")]
mod footprint;
#[cfg(feature = "world")]
mod robot;
#[cfg(feature = "world")]
mod scene;
#[cfg(feature = "world")]
mod session;
#[cfg(feature = "world")]
mod viewer;

pub use end::{end_message, judgement_message};
pub use error::WireError;
pub use geometry::{geometry_message, read_geometry};
pub use header::{
    drive_message, header_digest, joint_groups_message, joint_groups_of, layout_of, read_identity, reward_of,
};
pub use known::{GAINS, KnownSensor, ROBOTS, SENSORS, known_gains, known_robot, known_sensor};
pub use pose::{pose_message, read_pose};
pub use request::{
    COMMAND_TIMEOUT_MS, FEATURE_SIDE_STEP, IMAGE_SIDE, MAX_NAME, RequestedSensor, RequestedSession,
    SENSORS_WITH_FEATURES, SensorUse, check_names, check_request, check_text, requested_sensors, reward_name,
};
pub use row::{contact_messages, read_row, state_message};
pub use task::task_message;

#[cfg(feature = "world")]
pub use domain_sample::{domain_sample_message, episode_ranges, light_of, prop_scale, randomization};
#[cfg(feature = "world")]
pub use footprint::footprint_messages;
#[cfg(feature = "world")]
pub use robot::{hand_body_names, joint_messages};
#[cfg(feature = "world")]
pub use scene::{RebuildError, robot_of, scene_of};
#[cfg(feature = "world")]
pub use session::session_terms;
#[cfg(feature = "world")]
pub use viewer::{Frames, frame_of, point_cloud, scene_update, time_of};
