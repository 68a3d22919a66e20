//! A humanoid as data: links, joints, limits, gains and collision shapes, read from one editable TOML file, checked, and
//! handed to the dynamics engine. [`Robot::by_name`] knows those of `robots/`; [`Robot::benchmark`] is the first of them.
//!
//! ```
//! use fiatlux_dynamics::ModelBuilder;
//! use fiatlux_robot::{BuildOptions, Robot, RobotError};
//! use nalgebra::UnitQuaternion;
//!
//! let robot = Robot::by_name("g1_bare")?;
//! assert_eq!(robot.joints().len(), 29);
//!
//! // A crouch with flat soles, set down on the floor.
//! let mut q = robot.q0().to_vec();
//! for (joint, angle) in [("hip_pitch", -0.4), ("knee", 0.8), ("ankle_pitch", -0.4)] {
//!     for side in ["left", "right"] {
//!         q[robot.joint_index(&format!("{side}_{joint}_joint")).unwrap()] = angle;
//!     }
//! }
//! let height = robot.height_on_soles(&q, &UnitQuaternion::identity())?;
//! assert!(height < robot.standing_height());
//!
//! // Into a model of the engine: fingers, palm and wrist are one body each side.
//! let mut builder = ModelBuilder::new();
//! let placed = robot.add_to(&mut builder, &BuildOptions::new(&robot))?;
//! let model = builder.build()?;
//! let knee = placed.ids(&model)?.joints[robot.joint_index("left_knee_joint").unwrap()];
//! assert_eq!(model.bodies()[knee.body.0].spec.name, "left_knee_link");
//! # Ok::<(), RobotError>(())
//! ```
mod build;
mod couple;
mod digest;
mod error;
mod file;
mod gains;
mod groups;
mod kinematics;
mod known;
pub mod lidar;
mod load;
mod load_shapes;
mod locate;
mod names;
mod refuse;
mod robot;
mod shape;
mod sites;
mod tree;
mod variant;

pub use build::{BuildOptions, JointIds, LinkIds, PlacedRobot, RobotIds};
pub use error::RobotError;
pub use gains::{GainSet, Gains, JointGains};
pub use groups::{ARMS, BODY, LEGS, MOVED, mirrored};
pub use robot::{BulbGrasp, CameraMount, Follows, Joint, JointGroups, Link, Robot};
pub use shape::{Shape, Surface};
pub use sites::{RobotSite, Sole};
