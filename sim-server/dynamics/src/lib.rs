//! Trees of rigid bodies with hinges, drives and frictional contact, stepped by one convex solve.
mod collide;
mod contact;
mod error;
mod factor;
mod inertia;
mod kinematics;
mod model;
mod solve;
mod spatial;
mod step;

pub use error::{ModelError, check_array};
pub use model::{
    Body, BodyId, BodySpec, Drive, Geometry, Hinge, Joint, MAX_DOFS, Material, Model, ModelBuilder, ShapeId, ShapeSpec,
    State,
};
pub use step::{Contact, Dynamics, Input, StepReport, Velocity, Wrench};
