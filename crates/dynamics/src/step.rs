//! One physics step, and what can be read after it.

use std::sync::Arc;

use nalgebra::{Isometry3, Vector3};

use crate::collide::Collider;
use crate::contact::Contact;
use crate::error::ModelError;
use crate::input::Input;
use crate::kinematics::integrate;
use crate::mechanics::Mechanics;
use crate::model::{Model, State};
use crate::rest::Rest;
use crate::row_set::MAX_WORDS;
use crate::solve::{Problem, Solver, StepReport, TOLERANCE, contacts_expected};
use crate::spatial::Velocity;
use crate::spec::BodyId;
use crate::variation::{PreparedVariation, Variation};

/// Farthest that a body may turn in one substep, rad: of the error of a step grows by the square of it. Energy is kept
/// within 0.5 % in 0.1 s of free flight with every joint at 15 rad/s, and within 1 % at 30 rad/s.
const SUBSTEP_ANGLE: f64 = 0.1;
/// Most substeps of a step, with which a body at 640 rad/s keeps to the angle.
const MAX_SUBSTEPS: u32 = 32;
/// Turning rate from which the bias force is taken at the mean velocity of the substep, rad/s. Below, what that changes is
/// lost in the damping of the drives.
const MEAN_BIAS_RATE: f64 = 4.0;
/// Most degrees of freedom whose sets fit in one word.
const NARROW_DOFS: usize = 128;
/// Residual at which the first solve gives the velocity that the bias force is taken at.
const FIRST_TOLERANCE: f64 = 1e-2;

/// Scratch memory and results of stepping one world, and how that world differs from the model. Results never depend on what
/// was stepped before.
#[derive(Debug, Clone)]
pub struct Dynamics {
    stepper: Stepper,
    solver: AnySolver,
    /// Square of each body's turning rate.
    turning: Vec<f64>,
    /// The state at the start of the step, for a second try.
    before: State,
}

/// All that one substep writes but the solver's memory.
#[derive(Debug, Clone)]
struct Stepper {
    mechanics: Mechanics,
    collider: Collider,
    rest: Rest,
    contacts: Vec<Contact>,
    efforts: Vec<f64>,
    mean_velocity: Vec<f64>,
}

/// A solver with sets of rows as wide as the model needs.
#[derive(Debug, Clone)]
enum AnySolver {
    Narrow(Solver<1>),
    Wide(Solver<MAX_WORDS>),
}

impl Dynamics {
    /// Memory for that model.
    pub fn new(model: &Model) -> Self {
        Self {
            stepper: Stepper {
                mechanics: Mechanics::new(model),
                collider: Collider::new(model),
                rest: Rest::new(model),
                contacts: Vec::with_capacity(4 * contacts_expected(model)),
                efforts: vec![0.0; model.drives().len()],
                mean_velocity: vec![0.0; model.nv],
            },
            solver: if model.nv <= NARROW_DOFS {
                AnySolver::Narrow(Solver::new(model))
            } else {
                AnySolver::Wide(Solver::new(model))
            },
            turning: vec![0.0; model.bodies.len()],
            before: model.reference_state(),
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
        self.stepper.mechanics.varied = variation.prepare(model)?.0;
        Ok(())
    }

    /// The same with a variation that was prepared for this model: at no cost, so that worlds can take turns.
    ///
    /// # Panics
    /// If it was prepared for a model with other bodies or shapes.
    pub fn vary(&mut self, variation: &PreparedVariation) {
        if let Some(varied) = &variation.0 {
            assert_eq!(varied.drives.len(), self.stepper.efforts.len(), "a variation prepared for this model");
        }
        self.stepper.mechanics.vary(variation);
    }

    /// True if this world differs from its model by just this variation.
    pub fn has_variation(&self, variation: &PreparedVariation) -> bool {
        match (&self.stepper.mechanics.varied, &variation.0) {
            (None, None) => true,
            (Some(ours), Some(other)) => Arc::ptr_eq(ours, other),
            _ => false,
        }
    }

    /// Computes poses and velocities of a state, to read without a step.
    pub fn update(&mut self, model: &Model, state: &State) {
        self.stepper.mechanics.update(model, state);
    }

    /// Advances `state` by `dt` s and leaves contact forces and efforts to read, both as their mean over the step. Poses and
    /// velocities of the end need an [`Dynamics::update`].
    ///
    /// A fast state takes several substeps, as many as follow from its speeds. A solve that does not converge is tried once
    /// more from the start of the step with twice as many.
    ///
    /// Joints that follow others are first set by their leaders ([`Model::follow`]); a lock on one has no effect.
    ///
    /// The caller has checked that targets and wrenches are finite ([`check_array`](crate::check_array)).
    ///
    /// # Panics
    /// If `targets` does not have one number per drive, if `locked` has neither `nv` flags nor none, or if a wrench acts on a
    /// body that the model lacks.
    pub fn step(&mut self, model: &Model, state: &mut State, input: &Input<'_>, dt: f64) -> StepReport {
        assert_eq!(input.targets.len(), model.drives().len(), "one target for each drive");
        assert!(input.locked.is_empty() || input.locked.len() == model.nv, "one flag for each degree of freedom");
        for (velocity, _) in state.qvel.iter_mut().zip(input.locked).filter(|(_, locked)| **locked) {
            *velocity = 0.0;
        }
        model.follow(state);
        let rate = self.turning_rate(model, &state.qvel);
        // A rate that is not finite takes one substep.
        let substeps = ((dt * rate / SUBSTEP_ANGLE).ceil() as u32).clamp(1, MAX_SUBSTEPS);
        let mean_bias = rate > MEAN_BIAS_RATE;
        self.before.copy_from(state);
        let first = self.advance(model, state, input, dt, substeps, mean_bias);
        if first.converged {
            return first;
        }
        state.copy_from(&self.before);
        let second = self.advance(model, state, input, dt, 2 * substeps, mean_bias);
        StepReport { iterations: first.iterations + second.iterations, retried: true, ..second }
    }

    /// Turning rate of the fastest body, rad/s, as if the axes above it were at right angles.
    fn turning_rate(&mut self, model: &Model, qvel: &[f64]) -> f64 {
        let mut fastest = 0.0;
        for (index, node) in model.nodes.iter().enumerate().skip(1) {
            let dof = node.dof;
            let own: f64 = if node.is_free {
                qvel[dof + 3..dof + 6].iter().map(|rate| rate * rate).sum()
            } else {
                qvel[dof] * qvel[dof]
            };
            self.turning[index] = self.turning[node.parent] + own;
            fastest = self.turning[index].max(fastest);
        }
        fastest.sqrt()
    }

    /// Leapfrog: half a substep's drift, the substeps' kicks with a whole drift between two of them, half a drift.
    fn advance(
        &mut self,
        model: &Model,
        state: &mut State,
        input: &Input<'_>,
        dt: f64,
        substeps: u32,
        mean_bias: bool,
    ) -> StepReport {
        let (part, length) = (1.0 / f64::from(substeps), dt / f64::from(substeps));
        let mut report = StepReport { substeps, converged: true, ..StepReport::default() };
        self.stepper.contacts.clear();
        self.stepper.efforts.fill(0.0);
        integrate(model, state, 0.5 * length);
        for substep in 1..=substeps {
            let stepper = &mut self.stepper;
            match &mut self.solver {
                AnySolver::Narrow(solver) => {
                    stepper.kick(solver, model, state, input, [dt, length], part, mean_bias, &mut report);
                }
                AnySolver::Wide(solver) => {
                    stepper.kick(solver, model, state, input, [dt, length], part, mean_bias, &mut report);
                }
            }
            integrate(model, state, if substep < substeps { length } else { 0.5 * length });
        }
        report
    }

    /// Pose of a body at the state last given to [`Dynamics::update`].
    pub fn world_from_body(&self, body: BodyId) -> Isometry3<f64> {
        self.stepper.mechanics.world_from_body(body)
    }

    /// Velocity of a body at the state last given to [`Dynamics::update`].
    pub fn velocity(&self, body: BodyId) -> Velocity {
        self.stepper.mechanics.velocity(body)
    }

    /// Centre of mass of a body in its frame, m, this world's variation included.
    ///
    /// # Panics
    /// If the model has no such body.
    pub fn center_of_mass(&self, model: &Model, body: BodyId) -> Vector3<f64> {
        self.stepper.mechanics.body_com(model, body)
    }

    /// Velocity of the centre of mass of all bodies of one tree at the state last given to [`Dynamics::update`], m/s.
    pub fn com_velocity(&self, model: &Model, root: BodyId) -> Vector3<f64> {
        self.stepper.mechanics.com_velocity(model, root)
    }

    /// Contacts of all substeps of the last step: points where they were in the middle of the substep, each with its part of
    /// the step's mean force.
    pub fn contacts(&self) -> &[Contact] {
        &self.stepper.contacts
    }

    /// Mean efforts of the drives over the last step, N m, in the order of [`Model::drives`].
    pub fn efforts(&self) -> &[f64] {
        &self.stepper.efforts
    }
}

impl Stepper {
    /// The velocity after `dt` s of all forces at the configuration at hand; `whole` is the length of the step, of which this
    /// is a part.
    fn kick<const W: usize>(
        &mut self,
        solver: &mut Solver<W>,
        model: &Model,
        state: &mut State,
        input: &Input<'_>,
        [whole, dt]: [f64; 2],
        part: f64,
        mean_bias: bool,
        report: &mut StepReport,
    ) {
        let Mechanics { kin, equation, varied, .. } = &mut self.mechanics;
        let parameters = varied.as_deref().unwrap_or(&model.nominal);
        kin.update(model, state);
        let first_contact = self.contacts.len();
        self.collider.update(kin, dt);
        self.rest.find(model, parameters, kin, &mut self.collider, state, input, whole);
        self.collider.find(model, &parameters.materials, &self.rest.groups, dt, &mut self.contacts);
        let contacts = &mut self.contacts[first_contact..];
        let free_twigs = solver.find_free_twigs(model, contacts);
        let resting = &self.rest.bodies;
        equation.update(model, parameters, kin, input.wrenches, &state.qvel, free_twigs, resting);
        equation.reduce(model);
        let mut problem = Problem { model, parameters, kin, equation, input, dt };
        solver.start(&problem, state, contacts, resting);
        if mean_bias {
            solver.minimise(&problem, FIRST_TOLERANCE, report);
            solver.follow(model);
            for (mean, (before, after)) in self.mean_velocity.iter_mut().zip(state.qvel.iter().zip(solver.velocity())) {
                *mean = 0.5 * (before + after);
            }
            equation.update_bias(model, parameters, kin, input.wrenches, &self.mean_velocity, resting);
            equation.reduce_bias(model);
            problem = Problem { model, parameters, kin, equation, input, dt };
        }
        report.converged &= solver.minimise(&problem, TOLERANCE, report);
        solver.follow(model);
        solver.finish(dt, part, state, contacts, &mut self.efforts, self.rest.touching(), report);
        self.rest.report(part, &mut self.contacts, report);
        self.rest.stop(model, parameters, kin, &mut self.collider, state, input, whole);
    }
}
