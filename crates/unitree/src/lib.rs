//! A Unitree G1's own interface: its messages, and our world behind it as the robot.
//!
//! The figures of the messages are those of Unitree's SDK (`NOTICE`). Nothing here was tried on a robot.
mod cdr;
#[cfg(feature = "dds")]
pub mod dds;
#[cfg(feature = "dds")]
mod deployment;
mod estimate;
mod guard;
#[allow(missing_docs)] // The maker's names of fields, explained where they need it.
mod messages;
mod motors;
#[cfg(feature = "dds")]
mod record;
mod remote;
#[cfg(feature = "dds")]
mod service;
mod stand_in;
#[cfg(feature = "dds")]
mod ticks;

pub use cdr::{CdrError, Message};
#[cfg(feature = "dds")]
pub use deployment::{DeployError, Deployed, Deployment, deploy};
pub use estimate::{Estimate, Estimator};
pub use guard::{Drive, Guard, Limits, Reason, Targets};
pub use messages::{
    HandCmds, HandMotorCmd, ImuState, LowCmd, LowState, MOTOR_SLOTS, MotorCmd, MotorState, Request, RequestHeader,
    RequestIdentity, Response, ResponseHeader,
};
pub use motors::{MOTORS, Motors, MotorsError};
pub use remote::Remote;
#[cfg(feature = "dds")]
pub use service::{Pace, StandIn};

/// Time between two commands, and between two states, s.
const PERIOD_S: f64 = 0.002;
