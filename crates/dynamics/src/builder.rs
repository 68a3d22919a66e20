//! Collects what a model is made of, checks it and derives its constant data.

use nalgebra::{Isometry3, Matrix3, Vector3};

use crate::check::{check_body, check_finite, check_friction, check_shape};
use crate::error::ModelError;
use crate::geometry::Geometry;
use crate::inverse_weights::inverse_weights;
use crate::model::{Body, CoupledJoint, CullGroupPair, MAX_DOFS, Model, Node};
use crate::parameters::{Inertial, InverseWeights, Parameters, new_id};
use crate::spec::{BodyId, BodySpec, Coupling, Joint, ShapeId, ShapeSpec};

/// Collects bodies and shapes and checks them.
#[derive(Debug, Clone)]
pub struct ModelBuilder {
    bodies: Vec<Body>,
    shapes: Vec<ShapeSpec>,
    excluded: Vec<(BodyId, BodyId)>,
    couplings: Vec<Coupling>,
    gravity: Vector3<f64>,
    nq: usize,
    nv: usize,
}

fn missing(part: &'static str, index: usize) -> ModelError {
    ModelError::Structure {
        part,
        name: format!("{part} {index}"),
        reason: "it does not exist yet; add it first".into(),
    }
}

/// Acceleration of free fall in a new model, m/s^2, along -z.
pub const DEFAULT_GRAVITY: f64 = 9.81;

impl Default for ModelBuilder {
    fn default() -> Self {
        Self::new()
    }
}

impl ModelBuilder {
    /// An empty world with [`DEFAULT_GRAVITY`].
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
            couplings: Vec::new(),
            gravity: Vector3::new(0.0, 0.0, -DEFAULT_GRAVITY),
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

    /// The bodies so far; entry 0 is the world.
    pub fn bodies(&self) -> &[Body] {
        &self.bodies
    }

    /// The shapes so far, indexed by [`ShapeId`].
    pub fn shapes(&self) -> &[ShapeSpec] {
        &self.shapes
    }

    /// Sets the coefficient of friction of a shape; the priority of its material stays.
    ///
    /// # Errors
    /// A shape that does not exist; a coefficient that is negative or not finite.
    pub fn set_friction(&mut self, id: ShapeId, friction: f64) -> Result<(), ModelError> {
        let shape = self.shapes.get_mut(id.0).ok_or_else(|| missing("shape", id.0))?;
        check_friction(&shape.name, friction)?;
        shape.material.friction = friction;
        Ok(())
    }

    /// Multiplies mass and inertia of a body: its shape stays and its density changes.
    ///
    /// # Errors
    /// A body that does not exist; a factor with which it has no mass or inertia that a solid can have.
    pub fn scale_mass(&mut self, id: BodyId, factor: f64) -> Result<(), ModelError> {
        let body = self.bodies.get_mut(id.0).filter(|_| id != BodyId::WORLD).ok_or_else(|| missing("body", id.0))?;
        let spec = BodySpec { mass: body.spec.mass * factor, inertia: body.spec.inertia * factor, ..body.spec.clone() };
        check_body(&spec)?;
        body.spec = spec;
        Ok(())
    }

    /// Lets the shapes of two bodies pass through each other. Bodies joined by a joint never touch anyway.
    pub fn exclude(&mut self, a: BodyId, b: BodyId) {
        self.excluded.push((a.min(b), a.max(b)));
    }

    /// Lets a hinge follow one above it. The leader's limits are narrowed to those that keep the follower within its own, which
    /// have no force then.
    ///
    /// # Errors
    /// A joint that is no hinge or that does not exist, a leader that is not above the follower, a follower with gains, with a
    /// leader already or with followers, a ratio of 0, a number that is not finite, or limits that leave the leader no angle.
    pub fn couple(&mut self, coupling: Coupling) -> Result<(), ModelError> {
        coupling.check(&self.bodies, &self.couplings)?;
        if let Joint::Hinge(follower) = &self.bodies[coupling.follower.0].spec.joint {
            let [lower, upper] = coupling.leader_range([follower.lower, follower.upper]);
            if let Joint::Hinge(leader) = &mut self.bodies[coupling.leader.0].spec.joint {
                (leader.lower, leader.upper) = (leader.lower.max(lower), leader.upper.min(upper));
            }
        }
        self.couplings.push(coupling);
        Ok(())
    }

    /// Finishes the model.
    ///
    /// # Errors
    /// A model without any body, an exclusion of a body that does not exist, gravity that is not finite, or a cull group whose
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
        self.check_cull_groups()?;
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
        let mut row_start = vec![0];
        for (dof, &body) in dof_body.iter().enumerate() {
            let width = chains[body].iter().take_while(|&&other| usize::from(other) <= dof).count();
            row_start.push(row_start[dof] + width);
        }
        self.couplings.sort_unstable_by_key(|coupling| coupling.follower);
        let coupled =
            self.couplings.iter().map(|&coupling| CoupledJoint::new(coupling, &self.bodies, &chains)).collect();
        let (cull_groups, pairs) = self.pair_shapes();
        let nominal = Parameters {
            bodies: self.bodies.iter().map(|body| Inertial::of(&body.spec)).collect(),
            drives,
            materials: self.shapes.iter().map(|shape| shape.material).collect(),
            inverse_weights: InverseWeights::default(),
            gravity: self.gravity,
            id: new_id(),
        };
        let node = |body: &Body| Node {
            parent: body.spec.parent.0,
            root: body.root.0,
            qpos: body.qpos_start,
            dof: body.dof_start,
            is_free: body.spec.joint == Joint::Free,
        };
        let mut model = Model {
            nodes: self.bodies.iter().map(node).collect(),
            bodies: self.bodies,
            shapes: self.shapes,
            nq: self.nq,
            nv: self.nv,
            dof_body,
            chains,
            row_start,
            pairs,
            cull_groups,
            excluded: self.excluded,
            coupled,
            nominal,
        };
        model.nominal.inverse_weights = inverse_weights(&model, &model.nominal);
        Ok(model)
    }

    /// Bounds of what stands still are found once, of what moves in each step: a cull group does one or the other.
    fn check_cull_groups(&self) -> Result<(), ModelError> {
        for shape in self.shapes.iter().filter(|shape| shape.body == BodyId::WORLD) {
            let moves = |other: &&ShapeSpec| other.cull_group == shape.cull_group && other.body != BodyId::WORLD;
            if let Some(other) = self.shapes.iter().find(moves) {
                let reason = format!(
                    "it shares cull group {} with '{}', which moves; give it its own",
                    shape.cull_group, other.name
                );
                return Err(ModelError::Structure { part: "shape", name: shape.name.clone(), reason });
            }
        }
        Ok(())
    }

    /// The shape pairs that may touch, by cull group and ordered by body pair.
    fn pair_shapes(&self) -> (Vec<Vec<usize>>, Vec<CullGroupPair>) {
        let mut labels: Vec<u16> = self.shapes.iter().map(|s| s.cull_group).collect();
        labels.sort_unstable();
        labels.dedup();
        let cull_groups: Vec<Vec<usize>> = labels
            .iter()
            .map(|label| (0..self.shapes.len()).filter(|&i| self.shapes[i].cull_group == *label).collect())
            .collect();
        let mut pairs = Vec::new();
        for a in 0..cull_groups.len() {
            for b in a..cull_groups.len() {
                let by_b = cull_groups[b].len() < cull_groups[a].len();
                let (rows, columns) = if by_b { (b, a) } else { (a, b) };
                let mut shapes = Vec::new();
                for &i in &cull_groups[rows] {
                    for &j in &cull_groups[columns] {
                        if (a < b || i < j) && self.may_touch(self.shapes[i].body, self.shapes[j].body) {
                            shapes.push((i as u16, j as u16));
                        }
                    }
                }
                shapes
                    .sort_by_key(|&(i, j)| (self.shapes[usize::from(i)].body, self.shapes[usize::from(j)].body, i, j));
                if !shapes.is_empty() {
                    let root = |i: &usize| self.bodies[self.shapes[*i].body.0].root;
                    let first = root(&cull_groups[a][0]);
                    let one_tree = cull_groups[a].iter().chain(&cull_groups[b]).all(|i| root(i) == first);
                    let mut rows = Vec::<(u16, std::ops::Range<usize>)>::new();
                    for (at, &(shape, _)) in shapes.iter().enumerate() {
                        match rows.last_mut() {
                            Some((last, range)) if *last == shape => range.end = at + 1,
                            _ => rows.push((shape, at..at + 1)),
                        }
                    }
                    let partners = shapes.iter().map(|&(_, partner)| partner).collect();
                    pairs.push(CullGroupPair { a, b, one_tree, by_b, rows, partners });
                }
            }
        }
        (cull_groups, pairs)
    }

    fn may_touch(&self, a: BodyId, b: BodyId) -> bool {
        let joined =
            |child: BodyId, parent: BodyId| parent != BodyId::WORLD && self.bodies[child.0].spec.parent == parent;
        a != b && !joined(a, b) && !joined(b, a) && self.excluded.binary_search(&(a.min(b), a.max(b))).is_err()
    }
}
