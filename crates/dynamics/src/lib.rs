//! Trees of rigid bodies with hinges, drives and frictional contact, stepped by one convex solve.
//!
//! The crate knows bodies, joints, shapes and wrenches; nothing of robots or lamps. A [`Model`] is built once and is then
//! constant, so that many worlds share it; a [`State`] is two arrays; a [`Dynamics`] is the scratch memory of one world and
//! its [`Variation`]: masses, gains and frictions of its own. A step is a pure function of these and an [`Input`]: no cache,
//! clock, thread or hash order reaches the result, so one recorded state restarts a world exactly.
//!
//! A pendulum released at a small angle is back after one period:
//!
//! ```
//! use fiatlux_dynamics::*;
//! use nalgebra::{Isometry3, Matrix3, Vector3};
//!
//! # fn main() -> Result<(), ModelError> {
//! let mut builder = ModelBuilder::new();
//! let hinge = Hinge { axis: Vector3::y_axis(), lower: -1.0, upper: 1.0, armature: 0.0, drive: None };
//! builder.add_body(BodySpec {
//!     name: "pendulum".into(),
//!     parent: BodyId::WORLD,
//!     parent_from_body: Isometry3::translation(0.0, 0.0, 2.0),
//!     joint: Joint::Hinge(hinge),
//!     mass: 1.5,
//!     com: Vector3::new(0.0, 0.0, -0.5),
//!     inertia: Matrix3::identity() * 0.02,
//! })?;
//! let model = builder.build()?;
//! let (mut dynamics, mut state) = (Dynamics::new(&model), model.reference_state());
//! state.qpos[0] = 0.01;
//!
//! // Inertia about the hinge over the restoring torque per radian.
//! let period = std::f64::consts::TAU * ((0.02 + 1.5 * 0.5_f64.powi(2)) / (1.5 * 9.81 * 0.5)).sqrt();
//! let steps = 2000;
//! for _ in 0..steps {
//!     let report = dynamics.step(&model, &mut state, &Input::default(), period / f64::from(steps));
//!     assert!(report.converged);
//! }
//! assert!((state.qpos[0] - 0.01).abs() < 1e-5 && state.qvel[0].abs() < 1e-4);
//! # Ok(())
//! # }
//! ```
//!
//! # Method
//!
//! All bodies, of all trees, share one vector of generalised velocities `v`. A step is one substep, or several where bodies
//! turn fast: as many as keep the fastest below 0.1 rad each, worked out from the state alone. One substep of length `dt`
//! moves positions along the velocity by half of it (the exponential map for rotations), changes the velocity there, and
//! moves positions by the other half (leapfrog, of second order where nothing is stiff). The change of the velocity is:
//!
//! 1. *Kinematics*: poses and joint axes as six-dimensional motion vectors in world axes about the position of each tree's
//!    root \[1\].
//! 2. *Dynamics*: bias forces `c` by the recursive Newton-Euler algorithm and the mass matrix `M` by composite rigid bodies
//!    \[1\], rotor inertias on its diagonal.
//! 3. *Collision*: bounding boxes of cull groups of shapes, then of shapes, then contact points: closed forms for balls,
//!    capsules, boxes and half-spaces, parry's face clipping for two boxes, separating axes and clipped faces for convex
//!    hulls. Margins grow with speed, up to 0.1 m,
//!    so that a fast body meets a surface in the step in which it would pass it.
//! 4. *Solve*: the next velocity minimises one convex function
//!
//!    ```text
//!    1/2 (v - v0)' M (v - v0) + dt c' v + sum drives(v) + sum limits(v) + sum contacts(J v)
//!    ```
//!
//!    The bias force `c` is that of the mean of `v0` and `v`: a first solve gives a `v` for it. At `v0` alone it would feed
//!    a fast body with energy. Drives are implicit in position and velocity and saturate inside the solve: the potential of
//!    `clamp(k (target - q - dt v) - d v, limit)`, the limit along the motion falling to 0 at the motor's rated speed.
//!    Contacts are regularised Coulomb cones, their impulse the projection of a linear law on the cone, which makes their
//!    potential convex \[2\]. Compliance is a small part of each pair's inverse mass (0.01 along the normal, 0.001 along the
//!    tangents): near-rigid, no creep to speak of. A penetration is taken back by a fifth per substep, at 1 m/s at most
//!    \[3\]. The price of convexity: a body that slides at speed `s` floats at `mu s dt`.
//! 5. Newton's method with a line search on the slope \[2\]. The Hessian keeps the trees' sparsity: it is factorised as
//!    `L' D L` from the leaves to the roots, which fills in nothing along a branch \[1\]; where contact couples two branches
//!    the extra columns are worked out from bit sets, as a sparse Cholesky's symbolic phase does \[4\]. The start is the
//!    current velocity, so contact points need no memory. Trees that no contact joins are minimised apart. Rows whose
//!    stiffness stays the same from iteration to iteration, with all that hangs on them, are eliminated once.
//!
//! A step whose solve does not converge is taken again with twice as many substeps.
//!
//! *Rolling.* A material may resist turning: about a contact's normal and about its tangents, by a torque in proportion to the
//! normal force. These are three more tangential components of the contact's cone, each counted as the force that its torque is at
//! the lever over the coefficient of friction, so that the law and its potential stay the same in five dimensions instead of two
//! (MuJoCo's elliptic cone of six dimensions).
//!
//! *Coupled joints.* A joint may follow one above it: its angle is a multiple of the leader's plus an offset, as a finger's outer joint
//! follows the inner one by a linkage. The equation is solved in the coordinates that are left ([`Coupling`]), so it holds exactly;
//! the state keeps all joints.
//!
//! *Rest.* A free body whose velocity is exactly zero and that nothing comes near is left out of a step if its pose would keep it:
//! a solve for this body alone among what is fixed must leave it below 0.002 mm/s, and below 0.05 mm/s when it is pushed to each
//! side by 1/200 of its weight or twisted by as much at its radius of gyration. That excludes balance on an edge, a slide that is
//! about to begin, and balls that resist no rolling. A body that becomes as slow as that in such a place gets a velocity of exactly
//! zero. So the state alone decides which bodies rest; what rests on a body that moves, or leans on another free body, is stepped.
//!
//! \[1\] R. Featherstone, Rigid Body Dynamics Algorithms, Springer 2008, chapters 2, 5, 6 and section 8.
//! \[2\] A. Castro, F. Permenter, X. Han, An Unconstrained Convex Formulation of Compliant Contact, IEEE T-RO 2023.
//! \[3\] J. Baumgarte, Stabilization of Constraints and Integrals of Motion, CMAME 1972.
//! \[4\] T. Davis, Direct Methods for Sparse Linear Systems, SIAM 2006, chapter 4.
//!
//! # Conventions
//!
//! SI units, radians. Quaternions are w first. A free joint's `qpos` is position and quaternion, its `qvel` the velocity of
//! the body's origin and the angular velocity, both in world axes. [`BodyId::WORLD`] is body 0.

mod builder;
mod check;
mod collide;
mod contact;
mod contact_law;
mod coupling;
mod distance;
mod equation_of_motion;
mod error;
mod factor;
mod geometry;
mod hull;
mod input;
mod inverse_weights;
mod joint_forces;
mod kinematics;
mod mechanics;
mod model;
mod parameters;
mod rest;
mod row_set;
mod solid;
mod solve;
mod spatial;
mod spec;
mod step;
mod variation;

pub use builder::{DEFAULT_GRAVITY, ModelBuilder};
pub use contact::Contact;
pub use distance::{Gaps, Nearest};
pub use error::{ModelError, check_array};
pub use factor::dot;
pub use geometry::Geometry;
pub use hull::{Hull, MAX_VERTICES};
pub use input::Input;
pub use mechanics::{Mechanics, Site};
pub use model::{Body, MAX_DOFS, Model, State};
pub use solid::Solid;
pub use solve::StepReport;
pub use spatial::{Velocity, Wrench};
pub use spec::{BodyId, BodySpec, Coupling, Drive, Hinge, Joint, Material, ShapeId, ShapeSpec};
pub use step::Dynamics;
pub use variation::{BodyVariation, DriveVariation, PreparedVariation, Variation};
