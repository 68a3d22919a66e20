//! What is simulated: bodies in trees, their joints, drives and shapes. Built once, checked, then constant.

use nalgebra::{Isometry3, Matrix3, UnitVector3, Vector3};

use crate::check::{check_body, check_finite, check_shape};
use crate::error::ModelError;
use crate::{Contact, Dynamics};

/// Index of a body; 0 is the world, which never moves.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct BodyId(pub usize);

impl BodyId {
    /// The world.
    pub const WORLD: BodyId = BodyId(0);
}

/// Index of a collision shape.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct ShapeId(pub usize);

/// A position drive: effort `stiffness (target - q) - damping qd`, clamped at `effort_limit`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Drive {
    /// N m/rad, at least 0.
    pub stiffness: f64,
    /// N m s/rad, at least 0.
    pub damping: f64,
    /// N m, above 0; may be infinite.
    pub effort_limit: f64,
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

/// How a body is joined to its parent.
#[derive(Debug, Clone, PartialEq)]
pub enum Joint {
    /// Six free coordinates; only below the world. The coordinates are absolute: `parent_from_body` is the reference pose.
    Free,
    /// One rotary coordinate about an axis through the body's origin.
    Hinge(Hinge),
}

/// A rigid body as given to [`ModelBuilder::add_body`].
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
    /// kg, above 0.
    pub mass: f64,
    /// Centre of mass in the body's frame, m.
    pub com: Vector3<f64>,
    /// Inertia about the centre of mass, body axes, kg m^2.
    pub inertia: Matrix3<f64>,
}

/// A collision shape's geometry, about its own frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Geometry {
    /// All points with z below 0; only on the world.
    HalfSpace,
    /// A ball.
    Sphere {
        /// m.
        radius: f64,
    },
    /// A segment of length `2 half_length` along z, thickened by `radius`.
    Capsule {
        /// m.
        radius: f64,
        /// Half the length of the segment between the two cap centres, m.
        half_length: f64,
    },
    /// A box.
    Cuboid {
        /// m.
        half_extents: Vector3<f64>,
    },
}

/// Coulomb friction of a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Material {
    /// Coefficient, at least 0.
    pub friction: f64,
    /// The surface with the higher priority decides a pair's coefficient; at equal priority the larger coefficient does.
    pub priority: i32,
}

/// A collision shape as given to [`ModelBuilder::add_shape`].
#[derive(Debug, Clone, PartialEq)]
pub struct ShapeSpec {
    /// Unique name.
    pub name: String,
    /// Body that carries it.
    pub body: BodyId,
    /// Pose in that body.
    pub body_from_shape: Isometry3<f64>,
    /// Geometry about the shape's own frame.
    pub geometry: Geometry,
    /// Surface.
    pub material: Material,
    /// Shapes of one cluster lie near each other (a limb, a piece of furniture): they are culled together. A cluster belongs
    /// to the world or to moving bodies, not to both.
    pub cluster: u16,
    /// What the caller wants contact forces summed by, such as a link's index; the engine only passes it on.
    pub label: u32,
}

/// A body of a finished model.
#[derive(Debug, Clone)]
pub struct Body {
    /// What was asked for.
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
    pub(crate) shapes: Vec<ShapeSpec>,
    pub(crate) gravity: Vector3<f64>,
    pub(crate) nq: usize,
    pub(crate) nv: usize,
    /// Body that owns each degree of freedom.
    pub(crate) dof_body: Vec<usize>,
    /// Degrees of freedom from the root down to each body, ascending.
    pub(crate) chains: Vec<Vec<u16>>,
    /// Bodies with drives, in the order of `targets`.
    pub(crate) drives: Vec<(BodyId, Drive)>,
    /// Pairs of clusters, each with the shape pairs that may touch.
    pub(crate) pairs: Vec<ClusterPair>,
    pub(crate) clusters: Vec<Vec<usize>>,
    pub(crate) excluded: Vec<(BodyId, BodyId)>,
    /// Mean over directions of the inverse inertia at each body's centre of mass in the reference pose, 1/kg. Drives count
    /// with what they add to the inertia in an implicit step of nominal length.
    pub(crate) inverse_weight: Vec<f64>,
    /// Diagonal of the inverse of the same matrix.
    pub(crate) dof_inverse_weight: Vec<f64>,
}

/// The shape pairs between two clusters that may touch.
#[derive(Debug, Clone)]
pub(crate) struct ClusterPair {
    pub a: usize,
    pub b: usize,
    /// All of these shapes belong to one tree.
    pub one_tree: bool,
    pub shapes: Vec<(u16, u16)>,
}

/// Collects bodies and shapes and checks them.
#[derive(Debug, Clone)]
pub struct ModelBuilder {
    bodies: Vec<Body>,
    shapes: Vec<ShapeSpec>,
    excluded: Vec<(BodyId, BodyId)>,
    gravity: Vector3<f64>,
    nq: usize,
    nv: usize,
}

impl Default for ModelBuilder {
    fn default() -> Self {
        Self::new()
    }
}

/// A state's `nv` may be at most this: rows of the factor are tracked as bits of one `u128`.
pub const MAX_DOFS: usize = 128;

/// Acceleration of free fall in a new model, m/s^2, along -z.
pub const STANDARD_GRAVITY: f64 = 9.81;

impl ModelBuilder {
    /// An empty world with [`STANDARD_GRAVITY`].
    pub fn new() -> Self {
        let world = Body {
            spec: BodySpec {
                name: "world".into(),
                parent: BodyId::WORLD,
                parent_from_body: Isometry3::identity(),
                joint: Joint::Free,
                mass: 0.0,
                com: Vector3::zeros(),
                inertia: Matrix3::zeros(),
            },
            qpos_start: 0,
            dof_start: 0,
            root: BodyId::WORLD,
        };
        Self {
            bodies: vec![world],
            shapes: Vec::new(),
            excluded: Vec::new(),
            gravity: Vector3::new(0.0, 0.0, -STANDARD_GRAVITY),
            nq: 0,
            nv: 0,
        }
    }

    /// Sets gravity, m/s^2 in world axes.
    pub fn set_gravity(&mut self, gravity: Vector3<f64>) {
        self.gravity = gravity;
    }

    /// Adds a body below an earlier one.
    ///
    /// # Errors
    /// A duplicate name, a parent that does not exist, a free joint below another body, a mass or an inertia that no
    /// solid can have, limits upside down, a negative gain or a number that is not finite.
    pub fn add_body(&mut self, spec: BodySpec) -> Result<BodyId, ModelError> {
        check_body(&spec)?;
        let structure = |reason: String| ModelError::Structure { part: "body", name: spec.name.clone(), reason };
        if self.bodies.iter().any(|b| b.spec.name == spec.name) {
            return Err(structure("the name is taken; names must be unique".into()));
        }
        if spec.parent.0 >= self.bodies.len() {
            return Err(structure(format!("parent {} does not exist yet; add parents first", spec.parent.0)));
        }
        let (width_q, width_v) = match spec.joint {
            Joint::Free if spec.parent != BodyId::WORLD => {
                return Err(structure("a free joint is only possible below the world".into()));
            }
            Joint::Free => (7, 6),
            Joint::Hinge(_) => (1, 1),
        };
        if self.nv + width_v > MAX_DOFS {
            return Err(structure(format!("the model would have more than {MAX_DOFS} degrees of freedom")));
        }
        let id = BodyId(self.bodies.len());
        let root = if spec.parent == BodyId::WORLD { id } else { self.bodies[spec.parent.0].root };
        self.bodies.push(Body { spec, qpos_start: self.nq, dof_start: self.nv, root });
        self.nq += width_q;
        self.nv += width_v;
        Ok(id)
    }

    /// Adds a collision shape to a body.
    ///
    /// # Errors
    /// A duplicate name, a body that does not exist, a half-space on a moving body, a size that is not positive, or
    /// negative friction.
    pub fn add_shape(&mut self, spec: ShapeSpec) -> Result<ShapeId, ModelError> {
        check_shape(&spec)?;
        let structure =
            |reason: &str| ModelError::Structure { part: "shape", name: spec.name.clone(), reason: reason.into() };
        if self.shapes.iter().any(|s| s.name == spec.name) {
            return Err(structure("the name is taken; names must be unique"));
        }
        if spec.body.0 >= self.bodies.len() {
            return Err(structure("its body does not exist; add bodies first"));
        }
        if spec.geometry == Geometry::HalfSpace && spec.body != BodyId::WORLD {
            return Err(structure("a half-space can only belong to the world"));
        }
        if self.shapes.len() > usize::from(u16::MAX) {
            return Err(structure("too many shapes"));
        }
        self.shapes.push(spec);
        Ok(ShapeId(self.shapes.len() - 1))
    }

    /// Lets the shapes of two bodies pass through each other. Bodies joined by a joint never touch anyway.
    pub fn exclude(&mut self, a: BodyId, b: BodyId) {
        self.excluded.push((a.min(b), a.max(b)));
    }

    /// Finishes the model.
    ///
    /// # Errors
    /// A model without any body, an exclusion of a body that does not exist, gravity that is not finite, or a cluster whose
    /// shapes belong partly to the world.
    pub fn build(mut self) -> Result<Model, ModelError> {
        if self.bodies.len() == 1 {
            return Err(ModelError::Structure {
                part: "model",
                name: "world".into(),
                reason: "there is no body to simulate; add at least one".into(),
            });
        }
        check_finite("model", "world", "gravity", self.gravity.as_slice())?;
        if let Some((_, body)) = self.excluded.iter().find(|(_, body)| body.0 >= self.bodies.len()) {
            return Err(ModelError::Structure {
                part: "exclusion",
                name: format!("body {}", body.0),
                reason: "this body does not exist; exclude bodies that were added".into(),
            });
        }
        self.check_clusters()?;
        self.excluded.sort_unstable();
        self.excluded.dedup();
        let mut dof_body = vec![0; self.nv];
        let mut chains: Vec<Vec<u16>> = vec![Vec::new()];
        let mut drives = Vec::new();
        for (index, body) in self.bodies.iter().enumerate().skip(1) {
            let width = if let Joint::Hinge(hinge) = &body.spec.joint {
                drives.extend(hinge.drive.map(|drive| (BodyId(index), drive)));
                1
            } else {
                6
            };
            let mut chain = chains[body.spec.parent.0].clone();
            for dof in body.dof_start..body.dof_start + width {
                dof_body[dof] = index;
                chain.push(dof as u16);
            }
            chains.push(chain);
        }
        let (clusters, pairs) = self.pair_shapes();
        let mut model = Model {
            bodies: self.bodies,
            shapes: self.shapes,
            gravity: self.gravity,
            nq: self.nq,
            nv: self.nv,
            dof_body,
            chains,
            drives,
            pairs,
            clusters,
            excluded: self.excluded,
            inverse_weight: Vec::new(),
            dof_inverse_weight: Vec::new(),
        };
        model.inverse_weight = vec![0.0; model.bodies.len()];
        model.dof_inverse_weight = vec![1.0; model.nv];
        let (body_weights, dof_weights) = crate::inertia::inverse_weights(&model);
        model.inverse_weight = body_weights;
        model.dof_inverse_weight = dof_weights;
        Ok(model)
    }

    /// Bounds of what stands still are found once, of what moves in each step: a cluster does one or the other.
    fn check_clusters(&self) -> Result<(), ModelError> {
        for shape in self.shapes.iter().filter(|shape| shape.body == BodyId::WORLD) {
            let moves = |other: &&ShapeSpec| other.cluster == shape.cluster && other.body != BodyId::WORLD;
            if let Some(other) = self.shapes.iter().find(moves) {
                let reason =
                    format!("it shares cluster {} with '{}', which moves; give it its own", shape.cluster, other.name);
                return Err(ModelError::Structure { part: "shape", name: shape.name.clone(), reason });
            }
        }
        Ok(())
    }

    /// The shape pairs that may touch, by cluster and ordered by body pair.
    fn pair_shapes(&self) -> (Vec<Vec<usize>>, Vec<ClusterPair>) {
        let mut labels: Vec<u16> = self.shapes.iter().map(|s| s.cluster).collect();
        labels.sort_unstable();
        labels.dedup();
        let clusters: Vec<Vec<usize>> = labels
            .iter()
            .map(|label| (0..self.shapes.len()).filter(|&i| self.shapes[i].cluster == *label).collect())
            .collect();
        let mut pairs = Vec::new();
        for a in 0..clusters.len() {
            for b in a..clusters.len() {
                let mut shapes = Vec::new();
                for &i in &clusters[a] {
                    for &j in &clusters[b] {
                        if (a < b || i < j) && self.may_touch(self.shapes[i].body, self.shapes[j].body) {
                            shapes.push((i as u16, j as u16));
                        }
                    }
                }
                shapes
                    .sort_by_key(|&(i, j)| (self.shapes[usize::from(i)].body, self.shapes[usize::from(j)].body, i, j));
                if !shapes.is_empty() {
                    let root = |i: &usize| self.bodies[self.shapes[*i].body.0].root;
                    let first = root(&clusters[a][0]);
                    let one_tree = clusters[a].iter().chain(&clusters[b]).all(|i| root(i) == first);
                    pairs.push(ClusterPair { a, b, one_tree, shapes });
                }
            }
        }
        (clusters, pairs)
    }

    fn may_touch(&self, a: BodyId, b: BodyId) -> bool {
        let joined =
            |child: BodyId, parent: BodyId| parent != BodyId::WORLD && self.bodies[child.0].spec.parent == parent;
        a != b && !joined(a, b) && !joined(b, a) && self.excluded.binary_search(&(a.min(b), a.max(b))).is_err()
    }
}

impl Model {
    /// All bodies; entry 0 is the world.
    pub fn bodies(&self) -> &[Body] {
        &self.bodies
    }

    /// All shapes.
    pub fn shapes(&self) -> &[ShapeSpec] {
        &self.shapes
    }

    /// Gravity, m/s^2 in world axes.
    pub fn gravity(&self) -> Vector3<f64> {
        self.gravity
    }

    /// Length of `qpos`.
    pub fn nq(&self) -> usize {
        self.nq
    }

    /// Length of `qvel`.
    pub fn nv(&self) -> usize {
        self.nv
    }

    /// Driven bodies in the order of the target array.
    pub fn drives(&self) -> &[(BodyId, Drive)] {
        &self.drives
    }

    /// Pairs of bodies whose shapes never touch, beside those joined by a joint.
    pub fn excluded(&self) -> &[(BodyId, BodyId)] {
        &self.excluded
    }

    /// The body of that name.
    pub fn body(&self, name: &str) -> Option<BodyId> {
        self.bodies.iter().position(|b| b.spec.name == name).map(BodyId)
    }

    /// The state with every hinge at 0 and every free body at its reference pose, at rest.
    pub fn reference_state(&self) -> State {
        let mut state = State { qpos: vec![0.0; self.nq], qvel: vec![0.0; self.nv] };
        for (index, body) in self.bodies.iter().enumerate().skip(1) {
            if body.spec.joint == Joint::Free {
                state.set_pose(self, BodyId(index), &body.spec.parent_from_body);
            }
        }
        state
    }

    /// Every contact of a configuration with a gap of at most `margin` m, shapes unmoved. Allocates; for building and
    /// checking scenes, not for stepping.
    ///
    /// # Errors
    /// A `qpos` of the wrong length or with an entry that is not finite.
    pub fn contacts_at(&self, qpos: &[f64], margin: f64) -> Result<Vec<Contact>, ModelError> {
        let mut dynamics = Dynamics::new(self);
        dynamics.contacts_at(self, qpos, margin)
    }

    /// The friction coefficient that holds between two shapes.
    pub fn pair_friction(&self, a: ShapeId, b: ShapeId) -> f64 {
        let (a, b) = (self.shapes[a.0].material, self.shapes[b.0].material);
        match a.priority.cmp(&b.priority) {
            std::cmp::Ordering::Greater => a.friction,
            std::cmp::Ordering::Less => b.friction,
            std::cmp::Ordering::Equal => a.friction.max(b.friction),
        }
    }
}

/// Generalised position and velocity; with the targets and wrenches of a step it determines the next state exactly.
#[derive(Debug, Clone, PartialEq)]
pub struct State {
    /// `nq` numbers.
    pub qpos: Vec<f64>,
    /// `nv` numbers.
    pub qvel: Vec<f64>,
}

impl State {
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
