//! One physics step, and what can be read after it.

use nalgebra::{Isometry3, Vector3};

use crate::collide::Collider;
use crate::contact::Contact;
use crate::equation_of_motion::EquationOfMotion;
use crate::error::ModelError;
use crate::input::Input;
use crate::kinematics::{Kinematics, integrate};
use crate::model::{Model, State};
use crate::parameters::Parameters;
use crate::solve::{Problem, Solver, StepReport};
use crate::spatial::Velocity;
use crate::spec::BodyId;
use crate::variation::Variation;

/// Scratch memory and results of stepping one world, and how that world differs from the model. Results never depend on what
/// was stepped before.
#[derive(Debug, Clone)]
pub struct Dynamics {
    kin: Kinematics,
    equation: EquationOfMotion,
    collider: Collider,
    solver: Solver,
    contacts: Vec<Contact>,
    /// In place of the model's nominal parameters.
    varied: Option<Box<Parameters>>,
}

impl Dynamics {
    /// Memory for that model.
    pub fn new(model: &Model) -> Self {
        Self {
            kin: Kinematics::new(model),
            equation: EquationOfMotion::new(model),
            collider: Collider::new(model),
            solver: Solver::new(model),
            contacts: Vec::with_capacity(256),
            varied: None,
        }
    }

    /// Lets this world differ from its model from the next step on; the variation before is forgotten. Inertias behind the
    /// regularisation of contacts and limits are derived anew, so that the world moves as if its model had been built with
    /// these numbers. That takes about as long as building the model's constants: do it between episodes. An empty
    /// variation makes the world nominal again.
    ///
    /// # Errors
    /// A body, shape or drive that the model lacks, or a number that is not finite or out of range. The world then keeps
    /// what it had.
    pub fn set_variation(&mut self, model: &Model, variation: &Variation) -> Result<(), ModelError> {
        self.varied = if variation.is_empty() { None } else { Some(Box::new(variation.parameters(model)?)) };
        Ok(())
    }

    /// Computes poses and velocities of a state, to read without a step.
    pub fn update(&mut self, model: &Model, state: &State) {
        self.kin.update(model, state);
    }

    /// Advances `state` by `dt` s and leaves contact forces and efforts to read: contact points where they were at the start
    /// of the step, forces as their mean over it. Poses and velocities of the end need an [`Dynamics::update`].
    ///
    /// The caller has checked that targets and wrenches are finite ([`check_array`](crate::check_array)).
    ///
    /// # Panics
    /// If `targets` does not have one number per drive, if `locked` has neither `nv` flags nor none, or if a wrench acts on a
    /// body that the model lacks.
    pub fn step(&mut self, model: &Model, state: &mut State, input: &Input<'_>, dt: f64) -> StepReport {
        assert_eq!(input.targets.len(), model.drives().len(), "one target for each drive");
        assert!(input.locked.is_empty() || input.locked.len() == model.nv, "one flag for each degree of freedom");
        let parameters = self.varied.as_deref().unwrap_or(&model.nominal);
        self.kin.update(model, state);
        self.equation.update(model, parameters, &self.kin, input.wrenches);
        self.contacts.clear();
        self.collider.update(model, &self.kin, dt);
        self.collider.find(model, &parameters.materials, dt, &mut self.contacts);
        let problem = Problem { model, parameters, kin: &self.kin, equation: &self.equation, input, dt };
        let report = self.solver.solve(&problem, state, &mut self.contacts);
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

    /// Centre of mass of a body in its frame, m, this world's variation included.
    ///
    /// # Panics
    /// If the model has no such body.
    pub fn center_of_mass(&self, model: &Model, body: BodyId) -> Vector3<f64> {
        self.varied.as_deref().unwrap_or(&model.nominal).bodies[body.0].com
    }

    /// Velocity of the centre of mass of all bodies of one tree at the state last given to [`Dynamics::update`], m/s.
    pub fn com_velocity(&self, model: &Model, root: BodyId) -> Vector3<f64> {
        let (mut momentum, mut mass) = (Vector3::zeros(), 0.0);
        let parameters = self.varied.as_deref().unwrap_or(&model.nominal);
        for (index, _) in model.bodies.iter().enumerate().filter(|(_, body)| body.root == root) {
            let inertial = &parameters.bodies[index];
            momentum += self.kin.velocity_at(index, &inertial.com) * inertial.mass;
            mass += inertial.mass;
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
        self.update_equation(model, state);
        let nv = model.nv;
        let mut full = self.equation.mass_matrix.clone();
        for row in 0..nv {
            for column in row + 1..nv {
                full[row * nv + column] = full[column * nv + row];
            }
        }
        full
    }

    /// Generalised force that holds a state's accelerations at zero: Coriolis, centrifugal and gravity terms, `nv` numbers.
    pub fn bias_force(&mut self, model: &Model, state: &State) -> Vec<f64> {
        self.update_equation(model, state);
        self.equation.bias.clone()
    }

    fn update_equation(&mut self, model: &Model, state: &State) {
        let parameters = self.varied.as_deref().unwrap_or(&model.nominal);
        self.kin.update(model, state);
        self.equation.update(model, parameters, &self.kin, &[]);
    }
}
