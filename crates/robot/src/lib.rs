//! A humanoid as data: links, joints, limits, gains and collision shapes, read from one editable TOML file, checked, and
//! handed to the dynamics engine. [`Robot::g1_inspire`] is the Unitree G1 with two Inspire hands.
mod build;
mod error;
mod file;
mod gains;
mod hand;
mod kinematics;
mod load;
mod load_shapes;
mod locate;
mod refuse;
mod robot;
mod shape;
mod tree;

pub use build::{BuildOptions, JointIds, LinkIds, PlacedRobot, RobotIds};
pub use error::RobotError;
pub use gains::{GainSet, Gains, JointGains};
pub use hand::HandKind;
pub use robot::{CameraMount, Joint, Link, Robot};
pub use shape::{Shape, Surface};
