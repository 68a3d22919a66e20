//! Specification of a model: bodies, joints, drives and collision shapes, as the caller describes them.

use std::cmp::Ordering;

use nalgebra::{Isometry3, Matrix3, UnitVector3, Vector3};

use crate::geometry::Geometry;

/// Index of a body; 0 is the world, which never moves.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct BodyId(pub usize);

impl BodyId {
    /// The world itself, which carries all that stands still.
    pub const WORLD: BodyId = BodyId(0);
}

/// Index of a collision shape.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct ShapeId(pub usize);

/// A position drive: effort `stiffness (target - q) - damping qd`, clamped at `effort_limit`, and with no effort along the
/// motion beyond `speed_limit`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Drive {
    /// N m/rad, at least 0.
    pub stiffness: f64,
    /// N m s/rad, at least 0.
    pub damping: f64,
    /// N m, above 0; may be infinite.
    pub effort_limit: f64,
    /// Rated speed, rad/s, above 0; may be infinite. From [`Drive::CORNER`] of it on, the most effort along the motion falls
    /// linearly to 0 at the limit, as the torque of a motor does that runs out of voltage. Braking is not limited.
    pub speed_limit: f64,
}

impl Drive {
    /// Part of the speed limit up to which the whole effort is there.
    pub const CORNER: f64 = 0.9;
}

/// A one-axis rotary joint.
#[derive(Debug, Clone, PartialEq)]
pub struct Hinge {
    /// Axis in the body's frame.
    pub axis: UnitVector3<f64>,
    /// Lower limit, rad; may be minus infinity.
    pub lower: f64,
    /// Upper limit, rad; may be infinite.
    pub upper: f64,
    /// Inertia of the motor's rotor seen at the joint, kg m^2.
    pub armature: f64,
    /// The drive, if the joint has one.
    pub drive: Option<Drive>,
}

/// Joint between a body and its parent.
#[derive(Debug, Clone, PartialEq)]
pub enum Joint {
    /// Six free coordinates; only below the world. The coordinates are absolute: `parent_from_body` is the reference pose.
    Free,
    /// One rotary coordinate about an axis through the body's origin.
    Hinge(Hinge),
}

/// An exact coupling of two hinges: the follower's angle is `ratio` times the leader's plus `offset`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Coupling {
    /// Body below the joint that follows. It has no drive, or one without stiffness and damping, which keeps its place among the
    /// targets.
    pub follower: BodyId,
    /// Body below the joint that it follows: a body above the follower, which follows none itself.
    pub leader: BodyId,
    /// Turn of the follower per turn of the leader, not 0.
    pub ratio: f64,
    /// Angle of the follower where the leader's is 0, rad.
    pub offset: f64,
}

/// A rigid body as given to [`ModelBuilder::add_body`](crate::ModelBuilder::add_body).
#[derive(Debug, Clone, PartialEq)]
pub struct BodySpec {
    /// Unique name; also the name of its joint in exports.
    pub name: String,
    /// An earlier body, or [`BodyId::WORLD`].
    pub parent: BodyId,
    /// Pose in the parent at joint coordinate zero.
    pub parent_from_body: Isometry3<f64>,
    /// Joint to the parent.
    pub joint: Joint,
    /// Mass in kg, which must be above 0.
    pub mass: f64,
    /// Centre of mass in the body's frame, m.
    pub com: Vector3<f64>,
    /// Inertia about the centre of mass, body axes, kg m^2.
    pub inertia: Matrix3<f64>,
}

/// Friction of a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Material {
    /// Coulomb's coefficient, at least 0.
    pub friction: f64,
    /// Torque per normal force that a contact point holds against turning about its normal, m, at least 0: about the radius of
    /// the patch in which the surfaces touch.
    pub torsion: f64,
    /// The same against rolling, m: the lever of rolling resistance.
    pub rolling: f64,
    /// The surface with the higher priority decides a pair's numbers; at equal priority the larger ones do, one by one.
    pub priority: i32,
}

impl Material {
    /// A surface on which things turn and roll freely.
    pub const fn new(friction: f64, priority: i32) -> Self {
        Self { friction, torsion: 0.0, rolling: 0.0, priority }
    }

    /// The coefficient that holds between two surfaces.
    pub fn pair_friction(&self, other: &Material) -> f64 {
        self.pair(other).friction
    }

    /// The numbers that hold between two surfaces.
    #[inline(always)]
    pub(crate) fn pair(&self, other: &Material) -> Material {
        match self.priority.cmp(&other.priority) {
            Ordering::Greater => *self,
            Ordering::Less => *other,
            Ordering::Equal => Material {
                friction: self.friction.max(other.friction),
                torsion: self.torsion.max(other.torsion),
                rolling: self.rolling.max(other.rolling),
                priority: self.priority,
            },
        }
    }
}

/// A collision shape as given to [`ModelBuilder::add_shape`](crate::ModelBuilder::add_shape).
#[derive(Debug, Clone, PartialEq)]
pub struct ShapeSpec {
    /// Name of the shape, which no other shape of the model has.
    pub name: String,
    /// Body that carries it.
    pub body: BodyId,
    /// Pose in that body.
    pub body_from_shape: Isometry3<f64>,
    /// Geometry about the shape's own frame.
    pub geometry: Geometry,
    /// Friction of its surface.
    pub material: Material,
    /// Shapes of one cull group lie near each other (a limb, a piece of furniture): they are culled together. A cull group belongs
    /// to the world or to moving bodies, not to both.
    pub cull_group: u16,
    /// Key by which the caller sums contact forces, such as a link's index; the engine only passes it on.
    pub label: u32,
}
