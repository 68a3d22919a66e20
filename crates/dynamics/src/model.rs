//! The simulated model: bodies in trees, their joints, drives and shapes. Built once, checked, then constant.

use nalgebra::{Isometry3, Vector3};

use crate::parameters::Parameters;
use crate::row_set::MAX_WORDS;
use crate::spec::{BodyId, BodySpec, Coupling, Drive, Joint, ShapeSpec};

/// A state's `nv` may be at most this: enough for a robot and 32 free bodies. Rows of the factor are tracked as bits.
pub const MAX_DOFS: usize = 128 * MAX_WORDS;

/// A body of a finished model.
#[derive(Debug, Clone)]
pub struct Body {
    /// The caller's description.
    pub spec: BodySpec,
    /// First entry in `qpos`.
    pub qpos_start: usize,
    /// First entry in `qvel`.
    pub dof_start: usize,
    /// Root of its tree (itself for a root).
    pub root: BodyId,
}

/// A checked, immutable model. `nq` counts `qpos` (a free joint has 7: position, quaternion w first), `nv` counts `qvel`
/// (a free joint has 6: velocity of the body's origin, then angular velocity, both in world axes).
#[derive(Debug, Clone)]
pub struct Model {
    pub(crate) bodies: Vec<Body>,
    /// Where each body stands, apart from all else that is known of it, for loops over all bodies.
    pub(crate) nodes: Vec<Node>,
    pub(crate) shapes: Vec<ShapeSpec>,
    pub(crate) nq: usize,
    pub(crate) nv: usize,
    /// Body that owns each degree of freedom.
    pub(crate) dof_body: Vec<usize>,
    /// Degrees of freedom from the root down to each body, ascending.
    pub(crate) chains: Vec<Vec<u16>>,
    /// Where each row of a packed lower triangle starts, and the end of the last: a row has the degrees of freedom of its
    /// chain up to itself.
    pub(crate) row_start: Vec<usize>,
    /// Pairs of cull groups, each with the shape pairs that may touch.
    pub(crate) pairs: Vec<CullGroupPair>,
    pub(crate) cull_groups: Vec<Vec<usize>>,
    pub(crate) excluded: Vec<(BodyId, BodyId)>,
    pub(crate) coupled: Vec<CoupledJoint>,
    pub(crate) nominal: Parameters,
}

/// A body's place in its tree and in the arrays of a state.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Node {
    pub parent: usize,
    pub root: usize,
    pub qpos: usize,
    pub dof: usize,
    pub is_free: bool,
}

impl Node {
    /// Its degrees of freedom.
    pub fn dofs(&self) -> std::ops::Range<usize> {
        self.dof..self.dof + if self.is_free { 6 } else { 1 }
    }
}

/// A coupling and where its numbers stand.
#[derive(Debug, Clone)]
pub(crate) struct CoupledJoint {
    pub coupling: Coupling,
    pub leader_dof: usize,
    pub follower_dof: usize,
    pub leader_qpos: usize,
    pub follower_qpos: usize,
    /// Places of both in the chain of every body below the follower.
    pub leader_place: usize,
    pub follower_place: usize,
    /// Degrees of freedom below the follower.
    pub below: Vec<usize>,
}

/// The shape pairs between two cull groups that may touch, in rows: a shape of one group and those of the other one. Rows are
/// by the shapes of the smaller group, so that few of them rule out many pairs.
#[derive(Debug, Clone)]
pub(crate) struct CullGroupPair {
    pub a: usize,
    pub b: usize,
    /// All of these shapes belong to one tree.
    pub one_tree: bool,
    /// Rows are by the shapes of `b`.
    pub by_b: bool,
    /// A shape and the range of its partners; the pairs of two bodies stand together.
    pub rows: Vec<(u16, std::ops::Range<usize>)>,
    pub partners: Vec<u16>,
}

impl Model {
    /// All bodies; entry 0 is the world.
    pub fn bodies(&self) -> &[Body] {
        &self.bodies
    }

    /// All collision shapes, indexed by [`crate::ShapeId`].
    pub fn shapes(&self) -> &[ShapeSpec] {
        &self.shapes
    }

    /// Gravity, m/s^2 in world axes.
    pub fn gravity(&self) -> Vector3<f64> {
        self.nominal.gravity
    }

    /// Length of `qpos`, the generalised positions.
    pub fn nq(&self) -> usize {
        self.nq
    }

    /// Length of `qvel`, the generalised velocities.
    pub fn nv(&self) -> usize {
        self.nv
    }

    /// Driven bodies in the order of the target array.
    pub fn drives(&self) -> &[(BodyId, Drive)] {
        &self.nominal.drives
    }

    /// Pairs of bodies whose shapes never touch, besides those joined by a joint.
    pub fn excluded(&self) -> &[(BodyId, BodyId)] {
        &self.excluded
    }

    /// The body of that name.
    pub fn body(&self, name: &str) -> Option<BodyId> {
        self.bodies.iter().position(|b| b.spec.name == name).map(BodyId)
    }

    /// Entries of a row in a packed lower triangle.
    pub(crate) fn row(&self, dof: usize) -> std::ops::Range<usize> {
        self.row_start[dof]..self.row_start[dof + 1]
    }

    /// Entry of the diagonal in a packed lower triangle.
    pub(crate) fn diagonal(&self, dof: usize) -> usize {
        self.row_start[dof + 1] - 1
    }

    /// The state with every hinge at 0, but for those that follow others, and every free body at its reference pose, at rest.
    pub fn reference_state(&self) -> State {
        let mut state = State { qpos: vec![0.0; self.nq], qvel: vec![0.0; self.nv] };
        for (index, body) in self.bodies.iter().enumerate().skip(1) {
            if body.spec.joint == Joint::Free {
                state.set_pose(self, BodyId(index), &body.spec.parent_from_body);
            }
        }
        self.follow(&mut state);
        state
    }
}

/// Generalised position and velocity; with the targets and wrenches of a step it determines the next state exactly.
#[derive(Debug, Clone, PartialEq)]
pub struct State {
    /// Generalised positions: `nq` numbers, m and rad, quaternions as w, x, y, z.
    pub qpos: Vec<f64>,
    /// Generalised velocities: `nv` numbers, m/s and rad/s.
    pub qvel: Vec<f64>,
}

impl State {
    /// Takes over another state of the same model without allocation.
    pub(crate) fn copy_from(&mut self, other: &State) {
        self.qpos.copy_from_slice(&other.qpos);
        self.qvel.copy_from_slice(&other.qvel);
    }

    /// Places a free body; its velocity stays.
    ///
    /// # Panics
    /// If the body has no free joint.
    pub fn set_pose(&mut self, model: &Model, body: BodyId, world_from_body: &Isometry3<f64>) {
        let body = &model.bodies[body.0];
        assert!(body.spec.joint == Joint::Free && body.root != BodyId::WORLD, "{} is not free", body.spec.name);
        let (p, q) = (world_from_body.translation.vector, world_from_body.rotation);
        self.qpos[body.qpos_start..body.qpos_start + 7].copy_from_slice(&[p.x, p.y, p.z, q.w, q.i, q.j, q.k]);
    }
}
