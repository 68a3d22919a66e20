//! One physics step, and what can be read after it.

use nalgebra::{Isometry3, Vector3};

use crate::collide::Collider;
use crate::inertia::Dynamical;
use crate::kinematics::{Kinematics, integrate};
use crate::solve::Solver;
use crate::{BodyId, Model, ModelError, ShapeId, State, check_array};

/// One contact point of the last step (or of a query).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Contact {
    /// First shape.
    pub shape_a: ShapeId,
    /// Second shape.
    pub shape_b: ShapeId,
    /// Point half-way between the surfaces, world, m.
    pub position: Vector3<f64>,
    /// Unit normal from `a` to `b`, world.
    pub normal: Vector3<f64>,
    /// Gap, m; negative when the shapes overlap.
    pub distance: f64,
    /// Coefficient of friction of the pair.
    pub friction: f64,
    /// Mean force over the last physics step that `a` exerts on `b`, world, N. Zero in a query.
    pub force: Vector3<f64>,
}

/// Velocity of a body's origin and its angular velocity, both in world axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Velocity {
    /// m/s.
    pub linear: Vector3<f64>,
    /// rad/s.
    pub angular: Vector3<f64>,
}

/// Force through a body's centre of mass and torque about it, world axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Wrench {
    /// N.
    pub force: Vector3<f64>,
    /// N m.
    pub torque: Vector3<f64>,
}

/// What acts on the bodies during one step beside gravity, limits and contact.
#[derive(Debug, Clone, Copy, Default)]
pub struct Input<'a> {
    /// Joint targets, rad, in the order of [`Model::drives`].
    pub targets: &'a [f64],
    /// External wrenches.
    pub wrenches: &'a [(BodyId, Wrench)],
    /// Degrees of freedom held at rest, `nv` flags; empty: none.
    pub locked: &'a [bool],
}

/// How the solve of one step went.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct StepReport {
    /// Newton iterations.
    pub iterations: u32,
    /// False when the iteration cap was reached first, or when numbers out of range left no positive definite Hessian.
    pub converged: bool,
    /// Contact points that carried load or were closer than 0.5 mm.
    pub contacts: u32,
}

/// Scratch memory and results of stepping one world. Results never depend on what was stepped before.
#[derive(Debug, Clone)]
pub struct Dynamics {
    kin: Kinematics,
    dynamical: Dynamical,
    collider: Collider,
    solver: Solver,
    contacts: Vec<Contact>,
}

impl Dynamics {
    /// Memory for that model.
    pub fn new(model: &Model) -> Self {
        Self {
            kin: Kinematics::new(model),
            dynamical: Dynamical::new(model),
            collider: Collider::new(model),
            solver: Solver::new(model),
            contacts: Vec::with_capacity(256),
        }
    }

    /// Computes poses and velocities of a state, to read without a step.
    pub fn update(&mut self, model: &Model, state: &State) {
        self.kin.update(model, state);
    }

    /// Advances `state` by `dt` s and leaves contact forces and efforts to read: contact points where they were at the start
    /// of the step, forces as their mean over it. Poses and velocities of the end need an [`Dynamics::update`].
    ///
    /// The caller has checked that the targets are finite ([`check_array`]).
    ///
    /// # Panics
    /// If `targets` does not have one number per drive, or `locked` neither `nv` flags nor none.
    pub fn step(&mut self, model: &Model, state: &mut State, input: &Input<'_>, dt: f64) -> StepReport {
        assert_eq!(input.targets.len(), model.drives.len(), "one target for each drive");
        assert!(input.locked.is_empty() || input.locked.len() == model.nv, "one flag for each degree of freedom");
        self.kin.update(model, state);
        self.dynamical.update(model, &self.kin, input.wrenches);
        self.contacts.clear();
        self.collider.update(model, &self.kin, dt);
        self.collider.find(model, dt, &mut self.contacts);
        let report = self.solver.solve(model, &self.kin, &self.dynamical, state, &mut self.contacts, input, dt);
        integrate(model, state, dt);
        report
    }

    /// Pose of a body at the state last given to [`Dynamics::update`].
    pub fn world_from_body(&self, body: BodyId) -> Isometry3<f64> {
        self.kin.world_from_body(body.0)
    }

    /// Velocity of a body at the state last given to [`Dynamics::update`].
    pub fn velocity(&self, body: BodyId) -> Velocity {
        self.kin.velocity(body.0)
    }

    /// Velocity of the centre of mass of all bodies of one tree at the state last given to [`Dynamics::update`], m/s.
    pub fn com_velocity(&self, model: &Model, root: BodyId) -> Vector3<f64> {
        let (mut momentum, mut mass) = (Vector3::zeros(), 0.0);
        for (index, body) in model.bodies.iter().enumerate().filter(|(_, body)| body.root == root) {
            momentum += self.kin.velocity_at(index, &body.spec.com) * body.spec.mass;
            mass += body.spec.mass;
        }
        if mass > 0.0 { momentum / mass } else { momentum }
    }

    /// Contacts of the last step, with forces.
    pub fn contacts(&self) -> &[Contact] {
        &self.contacts
    }

    /// Efforts that the drives applied in the last step, N m, in the order of [`Model::drives`].
    pub fn efforts(&self) -> &[f64] {
        self.solver.efforts()
    }

    /// Mass matrix of a state, `nv * nv` numbers, row-major, armature included.
    pub fn mass_matrix(&mut self, model: &Model, state: &State) -> Vec<f64> {
        self.kin.update(model, state);
        self.dynamical.update(model, &self.kin, &[]);
        let nv = model.nv;
        let mut full = self.dynamical.mass_matrix.clone();
        for row in 0..nv {
            for column in row + 1..nv {
                full[row * nv + column] = full[column * nv + row];
            }
        }
        full
    }

    /// Generalised force that holds a state's accelerations at zero: Coriolis, centrifugal and gravity terms, `nv` numbers.
    pub fn bias_force(&mut self, model: &Model, state: &State) -> Vec<f64> {
        self.kin.update(model, state);
        self.dynamical.update(model, &self.kin, &[]);
        self.dynamical.bias.clone()
    }

    pub(crate) fn contacts_at(&mut self, model: &Model, qpos: &[f64], margin: f64) -> Result<Vec<Contact>, ModelError> {
        check_array("qpos", qpos, model.nq)?;
        let state = State { qpos: qpos.to_vec(), qvel: vec![0.0; model.nv] };
        self.kin.update(model, &state);
        self.collider.update(model, &self.kin, 0.0);
        let mut found = Vec::new();
        self.collider.find_all(model, margin, &mut found);
        Ok(found)
    }
}
