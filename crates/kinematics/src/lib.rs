//! Kinematics and statics of a robot for controllers, on the engine's own model and state: no second description of it.
//!
//! Poses and velocities of [`Site`]s, Jacobians, the mass matrix, the bias force and inverse dynamics are readings of
//! [`Mechanics`], which is the engine's. On top of it, [`InverseKinematics`] finds postures, and [`SupportSolver`] the contact
//! forces and joint targets that hold one. [`ProgramSolver`] is the quadratic program behind that.
//!
//! The robot reaches for a point ahead of its left shoulder:
//!
//! ```
//! use fiatlux_dynamics::{BodyId, ModelBuilder};
//! use fiatlux_kinematics::{Goal, InverseKinematics, Mechanics, Outcome};
//! use fiatlux_robot::{BuildOptions, Robot};
//! use nalgebra::Vector3;
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let robot = Robot::benchmark()?;
//! let mut builder = ModelBuilder::new();
//! let placed = robot.add_to(&mut builder, &BuildOptions::new(&robot))?;
//! let model = builder.build()?;
//! let ids = placed.ids(&model)?;
//! let mut state = model.reference_state();
//!
//! let palm = robot.sites().into_iter().find(|site| site.name == "left_palm").ok_or("no palm")?;
//! let palm = ids.site(&palm);
//! let arm = |name: &str| ["left_shoulder", "left_elbow", "left_wrist"].iter().any(|part| name.starts_with(part));
//! let joints: Vec<BodyId> =
//!     robot.joints().iter().zip(&ids.joints).filter(|(joint, _)| arm(&joint.name)).map(|(_, ids)| ids.body).collect();
//! let mut inverse = InverseKinematics::new(&model, ids.root, &joints, false)?;
//! let found = inverse.solve(&model, &mut state, &[Goal::position(palm, Vector3::new(0.35, 0.15, 1.0))])?;
//! assert_eq!(found.outcome, Outcome::Reached);
//!
//! // Where it is now, and how the palm would move with the elbow.
//! let mut mechanics = Mechanics::new(&model);
//! mechanics.update(&model, &state);
//! assert!((mechanics.world_from_site(&palm).translation.x - 0.35).abs() < 1e-4);
//! let mut jacobian = vec![0.0; 6 * model.nv()];
//! mechanics.jacobian(&model, &palm, &mut jacobian);
//! let elbow = ids.joints[robot.joint_index("left_elbow_joint").ok_or("no elbow")?].dof;
//! let along_x = jacobian[elbow];
//! assert!(along_x.abs() > 0.05);
//! # Ok(())
//! # }
//! ```
//!
//! It stands, more on the left foot, and the drives' targets make up for how soft they are:
//!
//! ```
//! # use fiatlux_dynamics::ModelBuilder;
//! # use fiatlux_robot::{BuildOptions, Robot};
//! use fiatlux_kinematics::{Acceleration, Mechanics, Support, SupportSolver, driven_angles};
//! use nalgebra::Vector3;
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! # let robot = Robot::by_name("g1_bare")?;
//! # let mut builder = ModelBuilder::new();
//! # let placed = robot.add_to(&mut builder, &BuildOptions::new(&robot))?;
//! # let model = builder.build()?;
//! # let ids = placed.ids(&model)?;
//! # let mut state = model.reference_state();
//! for (joint, angle) in ids.joints.iter().zip(robot.q0()) {
//!     state.qpos[joint.qpos] = *angle;
//! }
//! let mut supports = Vec::new();
//! for sole in robot.soles() {
//!     let body = ids.site(&sole.site).body;
//!     for point in sole.corners() {
//!         supports.push(Support { body, point, normal: Vector3::z_axis(), friction: 1.0, most: f64::INFINITY });
//!     }
//! }
//! // No corner of the right sole gets more than a ninth of the weight.
//! let weight = robot.total_mass() * 9.81;
//! supports[4..].iter_mut().for_each(|corner| corner.most = weight / 9.0);
//!
//! let (mut mechanics, mut solver) = (Mechanics::new(&model), SupportSolver::new(&model, ids.root)?);
//! mechanics.update_equation(&model, &state);
//! solver.solve(&model, &mut mechanics, &supports, &Acceleration::default())?;
//! let left: f64 = solver.forces()[..4].iter().map(|force| force.z).sum();
//! assert!(left / weight > 0.55);
//!
//! let mut posture = vec![0.0; model.drives().len()];
//! driven_angles(&model, &state, &mut posture);
//! let mut targets = posture.clone();
//! solver.targets(&model, &mechanics, &posture, &mut targets);
//! let knee = robot.joint_index("left_knee_joint").ok_or("no knee")?;
//! assert!((targets[knee] - posture[knee]).abs() > 0.01);
//! # Ok(())
//! # }
//! ```
//!
//! A finished model and a state are all that is taken: those of a scene, whose `sites` name treads, rails, plugs and the seat,
//! or of the robot alone, as here. There is no clock, no thread and no I/O, and no call depends on the one before. Searches that
//! take longer than a control step can be done in slices: [`Search`].
mod cholesky;
mod estimate;
mod goal;
mod inverse;
mod program;
mod slices;
mod stance;
mod supports;

pub use estimate::JointFilter;
pub use fiatlux_dynamics::{Mechanics, Nearest, Site};
pub use goal::{Clearance, Found, Goal, KinematicsError, Outcome, Part, SearchOptions};
pub use inverse::InverseKinematics;
pub use program::{Program, ProgramError, ProgramSolver};
pub use slices::{Search, Work, at_once};
pub use stance::{Held, Pull, Stance, StanceController, StanceGains};
pub use supports::{Acceleration, Support, SupportError, SupportSolver, driven_angles};
