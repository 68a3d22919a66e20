//! The next velocity as the minimum of one convex function, by Newton's method with a line search.

mod body_pair;
mod hessian;
mod island;
mod line_search;
mod twigs;

use crate::contact::Contact;
use crate::contact_law::Point;
use crate::equation_of_motion::EquationOfMotion;
use crate::factor::Factor;
use crate::input::Input;
use crate::joint_forces::{ImplicitDrive, JointLimit};
use crate::kinematics::Kinematics;
use crate::model::{CoupledJoint, Model, State};
use crate::parameters::Parameters;
use crate::row_set::RowSet;
use crate::spatial::{Force, Motion, V3};
use crate::spec::Joint;
pub(crate) use body_pair::stiffness_of;
use body_pair::{BodyPair, force_of};
use island::{Island, Islands};
use twigs::Twigs;

/// Residual at which the solve limits, relative to the largest momentum in it, in the norm of the inverse mass diagonal.
pub(crate) const TOLERANCE: f64 = 1e-6;
const MAX_ITERATIONS: u32 = 50;
/// Stiffness that holds a locked degree of freedom, in units of its inertia.
const LOCK: f64 = 1e12;

/// Part of a full step below which the next iteration is more cautious, otherwise less; how much more and less; and the
/// caution that is as good as none.
const SHORT: f64 = 0.5;
const MORE_CAUTION: f64 = 30.0;
const LESS_CAUTION: f64 = 0.1;
const MIN_CAUTION: f64 = 1e-3;

/// Contact points for which memory is kept from the start: at least the first number, or the second for each body that moves
/// by itself.
const CONTACTS_EXPECTED: [usize; 2] = [128, 20];
/// Gap up to which a contact point without load counts as touching in a report, m.
pub(crate) const TOUCHING: f64 = 5e-4;

/// The objective of one step.
#[derive(Clone, Copy)]
pub(crate) struct Problem<'a> {
    pub model: &'a Model,
    pub parameters: &'a Parameters,
    pub kin: &'a Kinematics,
    pub equation: &'a EquationOfMotion,
    pub input: &'a Input<'a>,
    pub dt: f64,
}

/// Statistics of the solve of one step.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct StepReport {
    /// Newton iterations, of both tries.
    pub iterations: u32,
    /// False when the iteration cap was reached first in some substep of the last try, or when numbers out of range left no
    /// positive definite Hessian.
    pub converged: bool,
    /// The first try did not converge.
    pub retried: bool,
    /// Substeps that the step was divided into, in the try that counts.
    pub substeps: u32,
    /// Contact points that carried load or were closer than 0.5 mm, in the substep that had most.
    pub contacts: u32,
    /// Depth of the deepest contact point, m; 0 if no shapes overlap.
    pub penetration: f64,
}

#[derive(Debug, Clone)]
pub(crate) struct Solver<const W: usize> {
    factor: Factor<W>,
    twigs: Twigs<W>,
    islands: Islands<W>,
    pairs: Vec<BodyPair<W>>,
    points: Vec<Point>,
    /// -1 where the two bodies of the caller's contact are swapped, so that b moves; otherwise 1.
    normal_sign: Vec<f64>,
    column_dof: Vec<u16>,
    columns: Vec<Motion>,
    drives: Vec<ImplicitDrive>,
    limits: Vec<JointLimit>,
    velocity: Vec<f64>,
    /// Inverse of the mass matrix's diagonal.
    weight: Vec<f64>,
    /// `M (v - v0)`.
    momentum_change: Vec<f64>,
    momentum: Vec<f64>,
    gradient: Vec<f64>,
    constraint: Vec<f64>,
    direction: Vec<f64>,
    mass_direction: Vec<f64>,
    /// Blend from the objective's own Hessian (0) to one that bounds the objective from above (1). Short steps of the line
    /// search raise it: Newton runs across the kinks of friction and saturation then.
    caution: f64,
    /// Contribution of drives, limits and locks to the Hessian's diagonal.
    diagonal: Vec<f64>,
    /// Rows for which the Hessian has been factorised.
    begun: RowSet<W>,
    /// Rows whose stiffness has been the same in every iteration, and all that hangs on them: they are eliminated first,
    /// and once.
    settled: RowSet<W>,
    /// The diagonal that they were eliminated with.
    settled_diagonal: Vec<f64>,
}

impl<const W: usize> Solver<W> {
    pub fn new(model: &Model) -> Self {
        let zeros = || vec![0.0; model.nv];
        let contacts = contacts_expected(model);
        Self {
            factor: Factor::new(model),
            twigs: Twigs::new(model),
            islands: Islands::new(model, contacts),
            pairs: Vec::with_capacity(contacts),
            points: Vec::with_capacity(contacts),
            normal_sign: Vec::with_capacity(contacts),
            column_dof: Vec::with_capacity(contacts * 24),
            columns: Vec::with_capacity(contacts * 24),
            drives: Vec::with_capacity(model.nv),
            limits: Vec::with_capacity(model.nv),
            velocity: zeros(),
            weight: zeros(),
            momentum_change: zeros(),
            momentum: zeros(),
            gradient: zeros(),
            constraint: zeros(),
            direction: zeros(),
            mass_direction: zeros(),
            caution: 0.0,
            diagonal: zeros(),
            begun: RowSet::EMPTY,
            settled: RowSet::EMPTY,
            settled_diagonal: zeros(),
        }
    }

    /// Finds the twigs that none of these contacts can load; the mass matrix of the problem may leave their rows out.
    pub fn find_free_twigs(&mut self, model: &Model, contacts: &[Contact]) -> RowSet<W> {
        self.twigs.find_free(model, contacts)
    }

    /// Sets up the problem; the velocity of the state is the first guess. Bodies at rest, which are flagged, keep it.
    pub fn start(&mut self, problem: &Problem<'_>, state: &State, contacts: &[Contact], resting: &[bool]) {
        let &Problem { model, equation, input, .. } = problem;
        self.set_up_joints(problem, state);
        self.set_up_contacts(problem, contacts, resting);
        self.velocity.copy_from_slice(&state.qvel);
        for (v, _) in self.velocity.iter_mut().zip(input.locked).filter(|(_, locked)| **locked) {
            *v = 0.0;
        }
        for (dof, weight) in self.weight.iter_mut().enumerate() {
            *weight = 1.0 / equation.mass_matrix[model.diagonal(dof)];
        }
        self.momentum_change.fill(0.0);
        (self.begun, self.settled) = (RowSet::EMPTY, RowSet::EMPTY);
        self.momentum.copy_from_slice(&equation.momentum);
        for pair in &self.pairs {
            let motion = pair.relative_motion(&self.columns, &self.column_dof, &self.velocity);
            for point in &mut self.points[pair.points.0..pair.points.1] {
                point.set_velocity(&motion);
            }
        }
    }

    /// Goes on from the velocity at hand to the minimum; false if it is not reached.
    pub fn minimise(&mut self, problem: &Problem<'_>, tolerance: f64, report: &mut StepReport) -> bool {
        let (mut converged, mut most_iterations) = (true, 0);
        for slot in 0..self.islands.slots() {
            let island = self.islands.take(slot);
            if !island.dofs.is_empty() {
                let (done, iterations) = self.minimise_island(problem, &island, tolerance);
                converged &= done;
                most_iterations = iterations.max(most_iterations);
            }
            self.islands.put_back(slot, island);
        }
        report.iterations += most_iterations;
        converged
    }

    /// True if the minimum is reached, and the iterations that it took.
    fn minimise_island(&mut self, problem: &Problem<'_>, island: &Island<W>, tolerance: f64) -> (bool, u32) {
        let mut iterations = 0;
        self.caution = 0.0;
        let mut done = self.gradient(problem, island, tolerance);
        while !done {
            if iterations == MAX_ITERATIONS || !self.newton_direction(problem, island) {
                return (false, iterations);
            }
            iterations += 1;
            let before = self.slope(island);
            self.advance(island, 1.0);
            done = self.gradient(problem, island, tolerance);
            let mut step = 1.0;
            // Still descending at the full step, or flat there: Newton's own step is the one that converges quadratically.
            if self.slope(island) > 1e-3 * before.abs() {
                step = self.line_search(problem, island, 1e-2 * before.abs());
                self.advance(island, step - 1.0);
                done = self.gradient(problem, island, tolerance);
            }
            self.caution = match (step < SHORT, self.caution > MIN_CAUTION) {
                (true, true) => (self.caution * MORE_CAUTION).min(1.0),
                (true, false) => 1.0,
                (false, true) => self.caution * LESS_CAUTION,
                (false, false) => 0.0,
            };
        }
        (true, iterations)
    }

    /// Sets the velocity of joints that follow others, which the minimisation leaves alone.
    pub fn follow(&mut self, model: &Model) {
        model.follow_velocities(&mut self.velocity);
    }

    /// The velocity at hand.
    pub fn velocity(&self) -> &[f64] {
        &self.velocity
    }

    /// Replaces `state.qvel` by the velocity at the end of the substep; writes contact forces and adds efforts, both as a
    /// `part` of their means over it. `resting` is the number of points with load of bodies at rest.
    pub fn finish(
        &mut self,
        dt: f64,
        part: f64,
        state: &mut State,
        contacts: &mut [Contact],
        efforts: &mut [f64],
        resting: u32,
        report: &mut StepReport,
    ) {
        let mut touching = resting;
        for (contact, (point, sign)) in contacts.iter_mut().zip(self.points.iter().zip(&self.normal_sign)) {
            contact.force = point.wrench().force * (part * sign / dt);
            touching += u32::from(contact.distance <= TOUCHING || point.impulse.z > 0.0);
            report.penetration = report.penetration.max(-contact.distance);
        }
        report.contacts = report.contacts.max(touching);
        for (effort, drive) in efforts.iter_mut().zip(&self.drives) {
            *effort += part * drive.effort(self.velocity[drive.dof]).0;
        }
        state.qvel.copy_from_slice(&self.velocity);
    }

    fn set_up_joints(&mut self, problem: &Problem<'_>, state: &State) {
        let &Problem { model, parameters, input, dt, .. } = problem;
        self.drives.clear();
        self.limits.clear();
        for ((body, drive), &target) in parameters.drives.iter().zip(input.targets) {
            let node = &model.nodes[body.0];
            self.drives.push(ImplicitDrive::new(node.dof, drive, target - state.qpos[node.qpos], dt));
        }
        for (index, body) in model.bodies.iter().enumerate().skip(1) {
            if let Joint::Hinge(hinge) = &body.spec.joint
                && !model.follows(index)
            {
                let inverse_weight = parameters.inverse_weights.dofs[body.dof_start];
                let limit = JointLimit::new(body.dof_start, hinge, state.qpos[body.qpos_start], inverse_weight, dt);
                self.limits.extend(limit);
            }
        }
    }

    fn set_up_contacts(&mut self, problem: &Problem<'_>, contacts: &[Contact], resting: &[bool]) {
        let &Problem { model, parameters, kin, dt, .. } = problem;
        self.pairs.clear();
        self.points.clear();
        self.normal_sign.clear();
        self.columns.clear();
        self.column_dof.clear();
        self.factor.reset_pattern();
        self.islands.reset();
        let body_of =
            |contact: &Contact| (model.shapes[contact.shape_a.0].body.0, model.shapes[contact.shape_b.0].body.0);
        let mut first = 0;
        while first < contacts.len() {
            let bodies = body_of(&contacts[first]);
            let count = contacts[first..].iter().take_while(|c| body_of(c) == bodies).count();
            let sign = if bodies.1 == 0 { -1.0 } else { 1.0 };
            let (a, b) = if bodies.1 == 0 { (bodies.1, bodies.0) } else { bodies };
            let origin = kin.origin[b];
            let inverse_mass = parameters.inverse_weights.bodies[a] + parameters.inverse_weights.bodies[b];
            for contact in &contacts[first..first + count] {
                let (arm, normal) = (contact.position - origin, contact.normal * sign);
                self.points.push(Point::new(&arm, &normal, contact, inverse_mass, dt));
                self.normal_sign.push(sign);
            }
            let start = self.columns.len();
            let dofs = self.push_columns(model, kin, a, b, &origin);
            if a != 0 {
                self.islands.join(a, b);
            }
            self.pairs.push(BodyPair {
                body: b,
                points: (first, first + count),
                columns: (start, self.columns.len()),
                dofs,
                stiffness: None,
            });
            first += count;
        }
        self.factor.finish_pattern();
        let pair_bodies = self.pairs.iter().map(|pair| pair.body);
        self.islands.gather(pair_bodies, resting, &self.drives, &self.limits);
    }

    /// Columns of the motion of `b` relative to `a`, by ascending degree of freedom; says which.
    fn push_columns(&mut self, model: &Model, kin: &Kinematics, a: usize, b: usize, origin: &V3) -> RowSet<W> {
        let (chain_a, chain_b) = (&model.chains[a], &model.chains[b]);
        // A joint that moves both bodies moves neither against the other.
        let shared = chain_a.iter().zip(chain_b).take_while(|(x, y)| x == y).count();
        let (mut rest_a, mut rest_b) = (&chain_a[shared..], &chain_b[shared..]);
        let shift = origin - kin.origin[a];
        let (mut dofs, start) = (RowSet::EMPTY, self.columns.len());
        loop {
            let from_a = match (rest_a.first(), rest_b.first()) {
                (None, None) => break,
                (Some(x), Some(y)) => x < y,
                (x, _) => x.is_some(),
            };
            let rest = if from_a { &mut rest_a } else { &mut rest_b };
            let dof = rest[0];
            *rest = &rest[1..];
            let axis = &kin.axes[usize::from(dof)];
            let column = if from_a {
                let moved = axis.moved(&shift);
                Motion { angular: -moved.angular, linear: -moved.linear }
            } else {
                *axis
            };
            self.columns.push(column);
            self.column_dof.push(dof);
            dofs.insert(dof.into());
        }
        for joint in &model.coupled {
            if dofs.contains(joint.follower_dof) {
                dofs.remove(joint.follower_dof);
                dofs.insert(joint.leader_dof);
                self.reduce_columns(start, joint);
            }
        }
        if chain_a.len() > shared && chain_b.len() > shared {
            self.factor.couple(dofs);
        }
        dofs
    }

    /// Replaces a follower's column among those from `start` on by its share in the leader's. A leader that moves both bodies has
    /// no column so far, and stands above all that have one.
    fn reduce_columns(&mut self, start: usize, joint: &CoupledJoint) {
        let place = |dofs: &[u16], dof: usize| dofs.partition_point(|&other| usize::from(other) < dof);
        let at = start + place(&self.column_dof[start..], joint.follower_dof);
        let column = self.columns.remove(at);
        self.column_dof.remove(at);
        let at = start + place(&self.column_dof[start..], joint.leader_dof);
        if self.column_dof.get(at).is_none_or(|&dof| usize::from(dof) != joint.leader_dof) {
            self.columns.insert(at, Motion::ZERO);
            self.column_dof.insert(at, joint.leader_dof as u16);
        }
        self.columns[at].add_scaled(&column, joint.coupling.ratio);
    }

    /// Gradient of the objective at the current velocity; true when it is small enough.
    fn gradient(&mut self, problem: &Problem<'_>, island: &Island<W>, tolerance: f64) -> bool {
        let &Problem { equation, input, dt, .. } = problem;
        for run in &island.dofs {
            self.constraint[run.clone()].fill(0.0);
            self.diagonal[run.clone()].fill(0.0);
        }
        for run in &island.drives {
            for drive in &self.drives[run.clone()] {
                let (effort, stiffness) = drive.effort(self.velocity[drive.dof]);
                self.constraint[drive.dof] = dt * effort;
                self.diagonal[drive.dof] = dt * stiffness;
            }
        }
        for run in &island.limits {
            for limit in &self.limits[run.clone()] {
                let velocity = self.velocity[limit.dof];
                if limit.allows(velocity) {
                    continue;
                }
                let (impulse, stiffness) = limit.impulse(velocity);
                self.constraint[limit.dof] += impulse;
                self.diagonal[limit.dof] += stiffness;
            }
        }
        for &pair in &island.pairs {
            let pair = &self.pairs[pair];
            let mut wrench = Force::ZERO;
            let mut loaded = false;
            for point in &mut self.points[pair.points.0..pair.points.1] {
                if point.update() {
                    wrench.add(&point.wrench());
                    loaded = true;
                }
            }
            if loaded {
                for k in pair.columns.0..pair.columns.1 {
                    self.constraint[usize::from(self.column_dof[k])] += self.columns[k].dot(&wrench);
                }
            }
        }
        let (mut residual, mut momentum, mut forced, mut constrained) = (0.0, 0.0, 0.0, 0.0);
        for run in &island.dofs {
            let inputs = self.weight[run.clone()].iter().zip(&equation.bias[run.clone()]);
            let sums = self.momentum[run.clone()].iter().zip(&self.momentum_change[run.clone()]);
            let outputs = self.constraint[run.clone()].iter().zip(&mut self.gradient[run.clone()]);
            for (k, ((&weight, &bias), ((&before, &change), (&constraint, gradient)))) in
                inputs.zip(sums.zip(outputs)).enumerate()
            {
                let bias = dt * bias;
                let locked = !input.locked.is_empty() && input.locked[run.start + k];
                *gradient = if locked { 0.0 } else { change + bias - constraint };
                let total = before + change;
                residual += weight * *gradient * *gradient;
                momentum += weight * total * total;
                forced += weight * bias * bias;
                constrained += weight * constraint * constraint;
            }
        }
        residual <= tolerance * tolerance * momentum.max(forced).max(constrained)
    }

    /// Newton's direction; false if the Hessian is not positive definite, which only numbers out of range can cause.
    fn newton_direction(&mut self, problem: &Problem<'_>, island: &Island<W>) -> bool {
        if !self.factorise(problem, island) {
            return false;
        }
        for run in &island.dofs {
            for dof in run.clone() {
                self.direction[dof] = -self.gradient[dof];
            }
        }
        self.twigs.solve_down(island.rows, problem.kin, &mut self.direction);
        self.factor.solve(&mut self.direction, island.rows & !self.twigs.free());
        self.twigs.solve_up(island.rows, problem.kin, &mut self.direction);
        // The Hessian's share less that of stiffness.
        for run in &island.dofs {
            for dof in run.clone() {
                self.mass_direction[dof] = -self.gradient[dof] - self.diagonal[dof] * self.direction[dof];
            }
        }
        for &pair in &island.pairs {
            let pair = &self.pairs[pair];
            let motion = pair.relative_motion(&self.columns, &self.column_dof, &self.direction);
            for point in &mut self.points[pair.points.0..pair.points.1] {
                point.set_direction(&motion);
            }
            if let Some(stiffness) = &pair.stiffness {
                let force = force_of(stiffness, &motion);
                for k in pair.columns.0..pair.columns.1 {
                    self.mass_direction[usize::from(self.column_dof[k])] -= self.columns[k].dot(&force);
                }
            }
        }
        true
    }

    fn advance(&mut self, island: &Island<W>, step: f64) {
        for run in &island.dofs {
            for dof in run.clone() {
                self.velocity[dof] += step * self.direction[dof];
                self.momentum_change[dof] += step * self.mass_direction[dof];
            }
        }
        for &pair in &island.pairs {
            for point in &mut self.points[self.pairs[pair].points.0..self.pairs[pair].points.1] {
                point.advance(step);
            }
        }
    }
}

/// Contact points of a step for which memory is kept.
pub(crate) fn contacts_expected(model: &Model) -> usize {
    let [least, each] = CONTACTS_EXPECTED;
    least.max(each * model.nodes.iter().skip(1).filter(|node| node.is_free).count())
}
