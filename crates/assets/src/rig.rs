//! A small world for one trial: a floor, the objects, and what a trial adds.

use std::collections::BTreeMap;

use fiatlux_dynamics::{
    BodyId, BodySpec, DEFAULT_GRAVITY, Drive, Dynamics, Geometry, Hinge, Input, Joint, Material, Model, ModelBuilder,
    ShapeId, ShapeSpec, State, Wrench,
};
use fiatlux_world::{JointKind, Object, PHYSICS_DT, SceneConfig};
use nalgebra::{Isometry3, Matrix3, UnitVector3, Vector3};

use crate::error::TrialError;

/// The parts of a world before it is built.
pub(crate) struct Setup<'a> {
    config: &'a SceneConfig,
    builder: ModelBuilder,
    groups: u16,
}

/// An object in a world.
#[derive(Debug, Clone)]
pub(crate) struct Placed {
    /// Body of each link; those of fixed joints share one.
    pub bodies: Vec<BodyId>,
}

/// Support of an object's root in a world.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Base {
    Free,
    Fixed,
}

impl<'a> Setup<'a> {
    pub fn new(config: &'a SceneConfig) -> Result<Self, TrialError> {
        let mut setup = Self { config, builder: ModelBuilder::new(), groups: 0 };
        let floor = config.surfaces.floor.material();
        setup.add_shape(BodyId::WORLD, "floor", Isometry3::identity(), Geometry::HalfSpace, floor)?;
        Ok(setup)
    }

    /// A shape in a cull group of its own.
    pub fn add_shape(
        &mut self,
        body: BodyId,
        name: &str,
        body_from_shape: Isometry3<f64>,
        geometry: Geometry,
        material: Material,
    ) -> Result<ShapeId, TrialError> {
        self.groups += 1;
        Ok(self.builder.add_shape(ShapeSpec {
            name: name.into(),
            body,
            body_from_shape,
            geometry,
            material,
            cull_group: self.groups,
            label: 0,
        })?)
    }

    /// A box that can move.
    pub fn add_block(
        &mut self,
        name: &str,
        pose: Isometry3<f64>,
        half: Vector3<f64>,
        mass: f64,
    ) -> Result<BodyId, TrialError> {
        let square = half.component_mul(&half) * (mass / 3.0);
        let moments = Vector3::new(square.y + square.z, square.x + square.z, square.x + square.y);
        let body = self.builder.add_body(BodySpec {
            name: name.into(),
            parent: BodyId::WORLD,
            parent_from_body: pose,
            joint: Joint::Free,
            mass,
            com: Vector3::zeros(),
            inertia: Matrix3::from_diagonal(&moments),
        })?;
        let material = self.config.surfaces.crate_.material();
        self.add_shape(body, name, Isometry3::identity(), Geometry::Cuboid { half_extents: half }, material)?;
        Ok(body)
    }

    /// An object whose hinges have a drive, or none. `prefix` makes its names unique.
    pub fn add_object(
        &mut self,
        object: &Object,
        prefix: &str,
        world_from_object: Isometry3<f64>,
        base: Base,
        drive: Option<Drive>,
    ) -> Result<Placed, TrialError> {
        let welds = Welds::new(object);
        let mut bodies = Vec::new();
        let mut origins: Vec<Vector3<f64>> = Vec::new();
        for (index, link) in object.links.iter().enumerate() {
            if welds.root[index] != index {
                bodies.push(bodies[welds.root[index]]);
                origins.push(origins[welds.root[index]]);
                continue;
            }
            let spec = |parent, parent_from_body, joint, origin: Vector3<f64>| {
                let (mass, com, inertia) = welds.solid(object, index);
                let name = format!("{prefix}{}", link.name);
                BodySpec { name, parent, parent_from_body, joint, mass, com: com - origin, inertia }
            };
            let (spec, origin) = match &link.joint {
                None if base == Base::Fixed => {
                    bodies.push(BodyId::WORLD);
                    origins.push(Vector3::zeros());
                    continue;
                }
                None => (spec(BodyId::WORLD, world_from_object, Joint::Free, Vector3::zeros()), Vector3::zeros()),
                Some(joint) if joint.kind == JointKind::Revolute => {
                    let parent = welds.link(object, &joint.parent);
                    let anchor = Vector3::from(joint.anchor);
                    let offset =
                        Isometry3::from_parts((anchor - origins[parent]).into(), nalgebra::UnitQuaternion::identity());
                    let below = if bodies[parent] == BodyId::WORLD { world_from_object * offset } else { offset };
                    let axis = UnitVector3::new_normalize(Vector3::from(joint.axis));
                    let hinge = Hinge { axis, lower: joint.lower, upper: joint.upper, armature: 0.0, drive };
                    (spec(bodies[parent], below, Joint::Hinge(hinge), anchor), anchor)
                }
                Some(joint) => {
                    return Err(TrialError::Joint { object: object.name.clone(), joint: joint.name.clone() });
                }
            };
            bodies.push(self.builder.add_body(spec)?);
            origins.push(origin);
        }
        for (index, link) in object.links.iter().enumerate() {
            self.groups += 1;
            let (body, cull_group) = (bodies[index], self.groups);
            let offset = Isometry3::from_parts((-origins[index]).into(), nalgebra::UnitQuaternion::identity());
            let body_from_object = if body == BodyId::WORLD { world_from_object } else { offset };
            for part in object.parts(index, self.config)? {
                self.builder.add_shape(ShapeSpec {
                    name: format!("{prefix}{}_{}", link.name, part.name),
                    body,
                    body_from_shape: body_from_object * part.prop_from_part,
                    geometry: part.geometry,
                    material: part.material,
                    cull_group,
                    label: 0,
                })?;
            }
        }
        Ok(Placed { bodies })
    }

    pub fn build(self) -> Result<Rig, TrialError> {
        let model = self.builder.build()?;
        let mut rig = Rig { dynamics: Dynamics::new(&model), state: model.reference_state(), model, unconverged: 0 };
        rig.dynamics.update(&rig.model, &rig.state);
        Ok(rig)
    }
}

/// Links that fixed joints join to one body.
struct Welds {
    /// The first link of each link's body.
    root: Vec<usize>,
}

impl Welds {
    fn new(object: &Object) -> Self {
        let mut root: Vec<usize> = Vec::new();
        let places: BTreeMap<&str, usize> = object.links.iter().map(|link| link.name.as_str()).zip(0..).collect();
        for (index, link) in object.links.iter().enumerate() {
            let fixed = link.joint.as_ref().filter(|joint| joint.kind == JointKind::Fixed);
            root.push(fixed.map_or(index, |joint| root[places[joint.parent.as_str()]]));
        }
        Self { root }
    }

    /// The first link of the body of a link, by name.
    fn link(&self, object: &Object, name: &str) -> usize {
        object.links.iter().position(|link| link.name == name).map_or(0, |index| self.root[index])
    }

    /// Mass, centre and inertia of the body that begins with a link, in the object's frame.
    fn solid(&self, object: &Object, first: usize) -> (f64, Vector3<f64>, Matrix3<f64>) {
        let links = || object.links.iter().zip(&self.root).filter(|(_, root)| **root == first).map(|(link, _)| link);
        let mass: f64 = links().map(|link| link.mass).sum();
        let com = links().map(|link| Vector3::from(link.com) * (link.mass / mass)).sum::<Vector3<f64>>();
        let inertia = links().map(|link| {
            let arm = Vector3::from(link.com) - com;
            let about = Matrix3::from_diagonal_element(arm.norm_squared()) - arm * arm.transpose();
            link.inertia_matrix() + about * link.mass
        });
        (mass, com, inertia.sum())
    }
}

/// A world in motion.
pub(crate) struct Rig {
    pub model: Model,
    pub state: State,
    pub dynamics: Dynamics,
    /// Steps whose solve did not converge.
    pub unconverged: u32,
}

impl Rig {
    /// One physics step, with wrenches at centres of mass.
    pub fn step(&mut self, targets: &[f64], wrenches: &[(BodyId, Wrench)]) {
        let input = Input { targets, wrenches, locked: &[] };
        let report = self.dynamics.step(&self.model, &mut self.state, &input, PHYSICS_DT);
        self.unconverged += u32::from(!report.converged);
        self.dynamics.update(&self.model, &self.state);
    }

    /// Steps without influence from outside.
    pub fn rest(&mut self, seconds: f64, targets: &[f64]) {
        for _ in 0..steps(seconds) {
            self.step(targets, &[]);
        }
    }

    pub fn pose(&self, body: BodyId) -> Isometry3<f64> {
        self.dynamics.world_from_body(body)
    }

    /// Speed of a body's centre of mass, m/s, and its turning rate, rad/s.
    pub fn speeds(&self, body: BodyId) -> (f64, f64) {
        let velocity = self.dynamics.velocity(body);
        let com = self.pose(body).rotation * self.model.bodies()[body.0].spec.com;
        ((velocity.linear + velocity.angular.cross(&com)).norm(), velocity.angular.norm())
    }

    pub fn is_finite(&self) -> bool {
        self.state.qpos.iter().chain(&self.state.qvel).all(|value| value.is_finite())
    }

    /// The largest force and the deepest overlap between two sets of shapes in the last step, N and m.
    pub fn touch(&self, a: impl Fn(&ShapeSpec) -> bool, b: impl Fn(&ShapeSpec) -> bool) -> (f64, f64) {
        let shapes = self.model.shapes();
        let (mut force, mut depth) = (Vector3::zeros(), 0.0_f64);
        for contact in self.dynamics.contacts() {
            let [first, second] = [contact.shape_a, contact.shape_b].map(|shape| &shapes[shape.0]);
            let sign = match (a(first) && b(second), a(second) && b(first)) {
                (true, _) => 1.0,
                (false, true) => -1.0,
                _ => continue,
            };
            force += contact.force * sign;
            depth = depth.max(-contact.distance);
        }
        (force.norm(), depth)
    }
}

/// Physics steps in a time.
pub(crate) fn steps(seconds: f64) -> usize {
    libm::round(seconds / PHYSICS_DT) as usize
}

/// Weight of a mass, N.
pub(crate) fn weight(mass: f64) -> f64 {
    mass * DEFAULT_GRAVITY
}
