//! Goals of inverse kinematics, and its answers.

use fiatlux_dynamics::{BodyId, ShapeId, Site};
use nalgebra::{Isometry3, Quaternion, Unit, UnitQuaternion, Vector3};
use thiserror::Error;

/// The part that a goal is for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Part {
    /// A site.
    Site(Site),
    /// The centre of mass of the tree.
    CenterOfMass,
}

/// Where a part is wanted. A weight of 0 leaves an axis free, one of rotation as long as its turn is small.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Goal {
    /// The part that is brought there.
    pub part: Part,
    /// The wanted pose; a centre of mass has no rotation.
    pub world_from_part: Isometry3<f64>,
    /// Weight of the position error along each of the world's axes.
    pub position: [f64; 3],
    /// Weight of the rotation error about each of the world's axes, m/rad: at 0.3, 0.1 rad count as 3 cm.
    pub rotation: [f64; 3],
    /// Axis of the world about which the part may have any turn, however large.
    pub free: Option<Unit<Vector3<f64>>>,
}

impl Goal {
    /// A whole pose of a site.
    pub fn pose(site: Site, world_from_site: Isometry3<f64>) -> Self {
        Self {
            part: Part::Site(site),
            world_from_part: world_from_site,
            position: [1.0; 3],
            rotation: [0.3; 3],
            free: None,
        }
    }

    /// A pose of a site whose turn about an axis of the world is free.
    pub fn pose_about(site: Site, world_from_site: Isometry3<f64>, axis: Unit<Vector3<f64>>) -> Self {
        Self { free: Some(axis), ..Self::pose(site, world_from_site) }
    }

    /// The position of a site, m; its rotation is free.
    pub fn position(site: Site, position: Vector3<f64>) -> Self {
        let world_from_part = Isometry3::from_parts(position.into(), UnitQuaternion::identity());
        Self { part: Part::Site(site), world_from_part, position: [1.0; 3], rotation: [0.0; 3], free: None }
    }

    /// x and y of the centre of mass, m; its height is free.
    pub fn com_over(x: f64, y: f64) -> Self {
        let world_from_part = Isometry3::translation(x, y, 0.0);
        Self { part: Part::CenterOfMass, world_from_part, position: [1.0, 1.0, 0.0], rotation: [0.0; 3], free: None }
    }

    /// Turn that brings the part to the nearest of the rotations that will do, as an axis of the world times an angle, rad. It has none
    /// about a free axis, whose turn would else go into the other two where it is large.
    pub(super) fn turn_from(&self, rotation: &UnitQuaternion<f64>) -> Vector3<f64> {
        let turn = self.world_from_part.rotation * rotation.inverse();
        let Some(axis) = self.free else { return turn.scaled_axis() };
        let half = libm::atan2(-turn.imag().dot(&axis), turn.w);
        let back = Quaternion::from_parts(libm::cos(half), axis.into_inner() * libm::sin(half));
        (UnitQuaternion::new_unchecked(back) * turn).scaled_axis()
    }
}

/// Limits of the search, and tolerances.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SearchOptions {
    /// Largest position error that counts as reached, m.
    pub position_tolerance: f64,
    /// Largest rotation error that counts as reached, rad.
    pub rotation_tolerance: f64,
    /// Most postures that it starts from; the first is the one given.
    pub tries: usize,
    /// Most steps from each of them.
    pub steps: usize,
    /// Joints keep this distance from their limits, rad.
    pub limit_margin: f64,
    /// Part of each joint's range, about its rest, that the postures are spread over which it starts from: 1 for all of it.
    pub spread: f64,
    /// Part of the way to the rest posture that each step takes where the goals leave it free, from 0 to 1.
    pub rest_pull: f64,
}

impl Default for SearchOptions {
    fn default() -> Self {
        Self {
            position_tolerance: 1e-4,
            rotation_tolerance: 1e-3,
            tries: 40,
            steps: 60,
            limit_margin: 0.0,
            spread: 1.0,
            rest_pull: 0.0,
        }
    }
}

/// Two shapes that are kept apart.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Clearance {
    /// The shapes; at least one moves with the robot.
    pub shapes: (ShapeId, ShapeId),
    /// Smallest gap between them, m; below 0 they may overlap by so much.
    pub margin: f64,
}

/// Outcome of a search.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// All goals are reached.
    Reached,
    /// The best posture found has a joint at a limit that keeps it from the goals.
    Limit {
        /// Body below that joint.
        body: BodyId,
    },
    /// The goals are out of reach, or contradict each other.
    OutOfReach,
}

/// The result; the state has the posture that it belongs to, the best that was found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Found {
    /// Success, or the reason why a goal is not reached.
    pub outcome: Outcome,
    /// Largest position error of a goal, m, over the axes that have a weight.
    pub position_error: f64,
    /// Largest rotation error of a goal, rad, over the axes that have a weight.
    pub rotation_error: f64,
    /// Most that two shapes are nearer to each other than their margin, m.
    pub clearance_error: f64,
    /// Postures that it started from.
    pub tries: usize,
    /// Steps of all tries.
    pub steps: usize,
}

/// Why a solver cannot be made, or cannot start.
#[derive(Debug, Clone, PartialEq, Error)]
#[allow(missing_docs)] // The messages say it.
pub enum KinematicsError {
    #[error("body {body} is not a hinge below root {root}; name bodies of one robot")]
    Joint { body: usize, root: usize },
    #[error("the joint of body {body} follows that of body {leader}; name body {leader} in its place")]
    Follower { body: usize, leader: usize },
    #[error("body {0} is not a free root; leave the base fixed, or name the robot's root")]
    Root(usize),
    #[error("clearance {0} names a shape that the model does not have; take both from this model")]
    Shape(usize),
    #[error("{field} has a number that is not finite")]
    NotFinite { field: &'static str },
    #[error("{field} has {found} numbers where {expected} are needed")]
    Length { field: &'static str, expected: usize, found: usize },
}
