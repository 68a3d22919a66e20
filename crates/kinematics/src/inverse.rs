//! Inverse kinematics: joint angles, on request with the pose of a floating base, at which sites are where they are wanted.
//!
//! Damped least squares: each step minimises the weighted error of the goals to first order, damped by the error itself, so
//! that it is short far away and near singular postures, and Newton's close to the goal \[1\]. Joints that press against a
//! limit are left out of a step. Two shapes that a step would bring nearer than their margin add a row to it, as a goal does:
//! the growth of their distance that the margin needs. Where a try gets stuck, the next one starts from another posture of a
//! fixed table.
//!
//! \[1\] T. Sugihara, Solvability-Unconcerned Inverse Kinematics by the Levenberg-Marquardt Method, IEEE T-RO 2011.

mod setup;

use std::f64::consts::PI;

use fiatlux_dynamics::{BodyId, Mechanics, Model, Nearest, State, dot};
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};

use self::setup::{check_clearances, check_finite};
use crate::cholesky::{add_scaled, factor, solve};
use crate::goal::{Clearance, Found, Goal, KinematicsError, Outcome, Part, SearchOptions};
use crate::slices::{Work, at_once};

/// Rows of a goal: a position and a rotation.
const ROWS: usize = 6;
/// Damping that stays where the error is 0, m^2.
const DAMPING: f64 = 1e-6;
/// Longest change of a joint or turn of the base in one step, rad.
const STEP: f64 = 0.6;
/// A try ends where this many steps did not halve the error.
const PATIENCE: usize = 6;
/// A step minds shapes that are farther apart than their margin by at most this, m.
const FORESIGHT: f64 = 0.05;
/// Most times that one step is solved, each with the joints and shapes that the solution before was about to press: without
/// and with shapes that are kept apart.
const PASSES: [usize; 2] = [4, 6];
/// Work of a step besides that of its pairs of shapes.
const STEP_WORK: usize = 40;
/// Range in which a joint without limits starts, rad.
const UNLIMITED: f64 = PI;

/// A joint that may move.
#[derive(Debug, Clone)]
struct Variable {
    body: BodyId,
    qpos: usize,
    lower: f64,
    upper: f64,
    /// Distance that it keeps from its limits besides that of the options, rad.
    margin: f64,
    /// Where it rests.
    rest: f64,
    /// Stride through its range from one try to the next.
    stride: f64,
}

/// A solver for one choice of joints. Results depend on the arguments alone; memory grows with the number of goals and is
/// reused.
#[derive(Debug, Clone)]
pub struct InverseKinematics {
    mechanics: Mechanics,
    root: BodyId,
    floating: bool,
    variables: Vec<Variable>,
    /// Column of each degree of freedom that may move, and its rate: 1, or the ratio at which it follows the column's joint.
    column: Vec<Option<(u16, f64)>>,
    /// Limits of the search.
    pub options: SearchOptions,
    clearances: Vec<Clearance>,
    /// Those that the step minds, by index, with the nearest points.
    close: Vec<(usize, Nearest)>,
    /// Which of them have a part in it.
    is_pressed: Vec<bool>,
    /// Bodies to place anew after a step.
    touched: Vec<BodyId>,
    is_above_goal: Vec<bool>,
    /// Entries of `qpos` that may change, their values at the start and in the best posture.
    entries: Vec<usize>,
    start: Vec<f64>,
    best: Vec<f64>,
    error: Vec<f64>,
    /// A column of the Jacobian after the other.
    jacobian: Vec<f64>,
    normal: Vec<f64>,
    force: Vec<f64>,
    change: Vec<f64>,
    is_held: Vec<bool>,
}

#[derive(Debug, Clone, Copy)]
struct Errors {
    /// Half the weighted sum of squares.
    cost: f64,
    position: f64,
    rotation: f64,
    clearance: f64,
}

impl Errors {
    fn report(&self, outcome: Outcome, tries: usize, steps: usize) -> Found {
        let (position_error, rotation_error, clearance_error) = (self.position, self.rotation, self.clearance);
        Found { outcome, position_error, rotation_error, clearance_error, tries, steps }
    }

    fn are_within(&self, options: &SearchOptions) -> bool {
        self.position.max(self.clearance) <= options.position_tolerance && self.rotation <= options.rotation_tolerance
    }
}

impl InverseKinematics {
    /// Moves the chosen joints of a state to the goals, and joints that follow others to where these have them. The state's own
    /// posture is tried first; velocities do not matter and stay.
    ///
    /// # Errors
    /// A state or a goal with a number that is not finite, or a state of another model. A goal that cannot be reached is not
    /// an error: see [`Found::outcome`].
    pub fn solve(&mut self, model: &Model, state: &mut State, goals: &[Goal]) -> Result<Found, KinematicsError> {
        at_once(self.solve_in_slices(model, state, goals, &Work::unlimited()))
    }

    /// The same, a slice at a time.
    ///
    /// # Errors
    /// As for [`Self::solve`].
    pub async fn solve_in_slices(
        &mut self,
        model: &Model,
        state: &mut State,
        goals: &[Goal],
        work: &Work,
    ) -> Result<Found, KinematicsError> {
        let (expected, found) = (model.nq(), state.qpos.len());
        if expected != found {
            return Err(KinematicsError::Length { field: "qpos", expected, found });
        }
        check_finite("qpos", &state.qpos)?;
        model.follow_positions(state);
        check_clearances(model, &self.clearances)?;
        for goal in goals {
            let pose = goal.world_from_part;
            check_finite("a goal", pose.translation.vector.as_slice())?;
            check_finite("a goal", pose.rotation.coords.as_slice())?;
            check_finite("a goal's weight", &goal.position)?;
            check_finite("a goal's weight", &goal.rotation)?;
            check_finite("a goal's axis", goal.free.as_ref().map_or(&[], |axis| axis.as_slice()))?;
        }
        self.mechanics.update(model, state);
        self.find_touched(model, goals);
        let (mut least, mut tries, mut steps) = (f64::INFINITY, 0, 0);
        copy(&self.entries, &state.qpos, &mut self.start);
        while tries < self.options.tries.max(1) {
            self.place_start(model, state, tries);
            tries += 1;
            let (mut mark, mut since) = (f64::INFINITY, 0);
            for _ in 0..=self.options.steps {
                self.mechanics.update_bodies(model, state, &self.touched);
                let errors = self.measure(model, goals);
                if errors.cost < least {
                    least = errors.cost;
                    copy(&self.entries, &state.qpos, &mut self.best);
                }
                if errors.are_within(&self.options) {
                    return Ok(errors.report(Outcome::Reached, tries, steps));
                }
                since += 1;
                if errors.cost < 0.5 * mark {
                    (mark, since) = (errors.cost, 0);
                } else if since > PATIENCE {
                    break;
                }
                self.linearise(model, goals);
                self.step(model, state, errors.cost);
                steps += 1;
                work.spend(STEP_WORK + self.clearances.len()).await;
            }
        }
        for (entry, value) in self.entries.iter().zip(&self.best) {
            state.qpos[*entry] = *value;
        }
        model.follow_positions(state);
        self.mechanics.update_bodies(model, state, &self.touched);
        let errors = self.measure(model, goals);
        self.linearise(model, goals);
        self.error[ROWS * goals.len()..].iter_mut().for_each(|lacks| *lacks = lacks.max(0.0));
        Ok(errors.report(self.obstacle(state), tries, steps))
    }

    /// Bodies between what moves and the goals.
    fn find_touched(&mut self, model: &Model, goals: &[Goal]) {
        let bodies = model.bodies();
        self.is_above_goal.fill(false);
        for goal in goals {
            match goal.part {
                Part::Site(site) => self.is_above_goal[site.body.0] = true,
                Part::CenterOfMass => (1..bodies.len())
                    .filter(|index| bodies[*index].root == self.root)
                    .for_each(|index| self.is_above_goal[index] = true),
            }
        }
        for Clearance { shapes: (a, b), .. } in &self.clearances {
            [a, b].into_iter().for_each(|shape| self.is_above_goal[model.shapes()[shape.0].body.0] = true);
        }
        for index in (1..bodies.len()).rev().filter(|index| bodies[*index].root == self.root) {
            if self.is_above_goal[index] {
                self.is_above_goal[bodies[index].spec.parent.0] = true;
            }
        }
        // Bodies below a joint that moves, its own included; the marks are those of the list being built.
        self.touched.clear();
        for (index, body) in bodies.iter().enumerate().skip(1).filter(|(_, body)| body.root == self.root) {
            let moves = self.column[body.dof_start].is_some() || self.touched.contains(&body.spec.parent);
            if moves && self.is_above_goal[index] {
                self.touched.push(BodyId(index));
            }
        }
    }

    /// Puts the joints where a try starts: as they were given, then on a table that fills their ranges evenly.
    fn place_start(&self, model: &Model, state: &mut State, tried: usize) {
        for (entry, value) in self.entries.iter().zip(&self.start) {
            state.qpos[*entry] = *value;
        }
        for variable in &self.variables {
            let (lower, upper) = self.range(variable);
            let angle = &mut state.qpos[variable.qpos];
            if tried > 0 {
                let part = (0.5 + (tried - 1) as f64 * variable.stride).fract();
                let (lower, upper, spread) = (lower.max(-UNLIMITED), upper.min(UNLIMITED), self.options.spread);
                *angle = lower + part * (upper - lower);
                if spread != 1.0 {
                    *angle = variable.rest + spread * (*angle - variable.rest);
                }
            }
            *angle = angle.clamp(lower, upper);
        }
        model.follow_positions(state);
    }

    /// Range of a joint, rad; its middle where the margins leave nothing.
    fn range(&self, variable: &Variable) -> (f64, f64) {
        let margin =
            (self.options.limit_margin + variable.margin).max(0.0).min(0.5 * (variable.upper - variable.lower));
        (variable.lower + margin, variable.upper - margin)
    }

    /// Writes the weighted errors of the goals, and of shapes that are near each other.
    fn measure(&mut self, model: &Model, goals: &[Goal]) -> Errors {
        let (mut position, mut rotation, mut clearance) = (0.0_f64, 0.0_f64, 0.0_f64);
        self.error.clear();
        self.error.resize(ROWS * goals.len(), 0.0);
        for (goal, rows) in goals.iter().zip(self.error.chunks_mut(ROWS)) {
            let (shift, turn) = match goal.part {
                Part::Site(site) => {
                    let world_from_site = self.mechanics.world_from_site(&site);
                    let shift = goal.world_from_part.translation.vector - world_from_site.translation.vector;
                    let turns = goal.rotation != [0.0; 3];
                    let turn = || goal.turn_from(&world_from_site.rotation);
                    (shift, if turns { turn() } else { Vector3::zeros() })
                }
                Part::CenterOfMass => {
                    let com = self.mechanics.center_of_mass(model, self.root).1;
                    (goal.world_from_part.translation.vector - com, Vector3::zeros())
                }
            };
            let counted = |error: &Vector3<f64>, weights: &[f64; 3]| {
                error.iter().zip(weights).filter(|(_, weight)| **weight != 0.0).map(|(e, _)| e * e).sum::<f64>().sqrt()
            };
            position = position.max(counted(&shift, &goal.position));
            rotation = rotation.max(counted(&turn, &goal.rotation));
            for axis in 0..3 {
                rows[axis] = goal.position[axis] * shift[axis];
                rows[3 + axis] = goal.rotation[axis] * turn[axis];
            }
        }
        let mut cost = 0.5 * dot(&self.error, &self.error);
        self.close.clear();
        if self.clearances.is_empty() {
            return Errors { cost, position, rotation, clearance };
        }
        let gaps = self.mechanics.gaps(model);
        for (index, Clearance { shapes: (a, b), margin }) in self.clearances.iter().enumerate() {
            if let Some(nearest) = gaps.nearest(*a, *b, margin + FORESIGHT) {
                let lacks = margin - nearest.distance;
                self.close.push((index, nearest));
                self.error.push(lacks);
                clearance = clearance.max(lacks);
                cost += 0.5 * lacks.max(0.0).powi(2);
            }
        }
        Errors { cost, position, rotation, clearance }
    }

    /// Writes the columns of the Jacobian of all goals and distances, weighted as their errors.
    fn linearise(&mut self, model: &Model, goals: &[Goal]) {
        let rows = self.error.len();
        self.jacobian.clear();
        self.jacobian.resize(rows * self.change.len(), 0.0);
        for (index, goal) in goals.iter().enumerate() {
            let (column, jacobian) = (&self.column, &mut self.jacobian);
            let mut write = |dof: usize, at: usize, values: &Vector3<f64>, weights: &[f64; 3]| {
                if let Some((column, rate)) = column[dof] {
                    let entries = &mut jacobian[usize::from(column) * rows + ROWS * index + at..][..3];
                    entries
                        .iter_mut()
                        .zip(values.iter().zip(weights))
                        .for_each(|(entry, (value, w))| *entry += rate * (w * value));
                }
            };
            match goal.part {
                Part::Site(site) => {
                    let point = self.mechanics.world_point(site.body, &site.body_from_site.translation.vector);
                    for (dof, velocity) in self.mechanics.point_columns(model, site.body, point) {
                        write(dof, 0, &velocity.linear, &goal.position);
                        let along = goal.free.map_or(Vector3::zeros(), |axis| axis.scale(axis.dot(&velocity.angular)));
                        write(dof, 3, &(velocity.angular - along), &goal.rotation);
                    }
                }
                Part::CenterOfMass => {
                    for (dof, velocity) in self.mechanics.com_columns(model, self.root) {
                        write(dof, 0, &velocity, &goal.position);
                    }
                }
            }
        }
        let of_goals = ROWS * goals.len();
        for (row, (index, nearest)) in (of_goals..rows).zip(&self.close) {
            let (a, b) = self.clearances[*index].shapes;
            for (shape, point, sign) in [(a, nearest.points[0], -1.0), (b, nearest.points[1], 1.0)] {
                for (dof, velocity) in self.mechanics.point_columns(model, model.shapes()[shape.0].body, point) {
                    if let Some((column, rate)) = self.column[dof] {
                        self.jacobian[usize::from(column) * rows + row] +=
                            rate * (sign * nearest.normal.dot(&velocity.linear));
                    }
                }
            }
        }
    }

    /// Takes one damped step along what was linearised.
    fn step(&mut self, model: &Model, state: &mut State, cost: f64) {
        let (rows, first) = (self.error.len(), self.change.len() - self.variables.len());
        let of_goals = rows - self.close.len();
        self.is_held.fill(false);
        self.is_pressed.clear();
        self.is_pressed.extend(self.error[of_goals..].iter().map(|lacks| *lacks > 0.0));
        // Each pass may find joints that would leave their range, and shapes that would come too near; the other joints then
        // make up for them.
        for _ in 0..PASSES[usize::from(!self.clearances.is_empty())] {
            self.normal.clear();
            self.normal.resize(rows * rows, 0.0);
            self.force.clear();
            self.force.extend_from_slice(&self.error);
            for index in 0..self.change.len() {
                self.change[index] = 0.0;
                if self.is_held[index] {
                    continue;
                }
                let column = &self.jacobian[index * rows..][..rows];
                for row in (0..rows).filter(|row| column[*row] != 0.0) {
                    add_scaled(&mut self.normal[row * rows..=row * rows + row], column, column[row]);
                }
                if let Some(variable) = index.checked_sub(first).map(|at| &self.variables[at]) {
                    self.change[index] = self.options.rest_pull * (variable.rest - state.qpos[variable.qpos]);
                    add_scaled(&mut self.force, column, -self.change[index]);
                }
            }
            for row in (of_goals..rows).filter(|row| !self.is_pressed[row - of_goals]) {
                self.normal[row * rows..][..row].fill(0.0);
                (row + 1..rows).for_each(|below| self.normal[below * rows + row] = 0.0);
                self.force[row] = 0.0;
            }
            for row in 0..rows {
                self.normal[row * rows + row] += cost + DAMPING;
            }
            if !factor(&mut self.normal, rows) {
                return;
            }
            solve(&self.normal, rows, &mut self.force);
            let mut is_done = true;
            for index in 0..self.change.len() {
                if self.is_held[index] {
                    continue;
                }
                self.change[index] += dot(&self.jacobian[index * rows..][..rows], &self.force);
                if let Some(variable) = index.checked_sub(first).map(|at| &self.variables[at]) {
                    let (lower, upper) = self.range(variable);
                    let (angle, change) = (state.qpos[variable.qpos], self.change[index]);
                    self.is_held[index] = angle <= lower && change < 0.0 || angle >= upper && change > 0.0;
                    is_done &= !self.is_held[index];
                }
            }
            for (row, is_pressed) in (of_goals..rows).zip(&mut self.is_pressed) {
                let growth = (0..self.change.len()).map(|index| self.jacobian[index * rows + row] * self.change[index]);
                if !*is_pressed && growth.sum::<f64>() < self.error[row] {
                    *is_pressed = true;
                    is_done = false;
                }
            }
            if is_done {
                break;
            }
        }
        self.apply(model, state);
    }

    /// Changes the state by the step, shortened where it is too long.
    fn apply(&mut self, model: &Model, state: &mut State) {
        let first = self.change.len() - self.variables.len();
        let longest =
            self.change[first.saturating_sub(3)..].iter().fold(0.0_f64, |most, change| most.max(change.abs()));
        let scale = if longest > STEP { STEP / longest } else { 1.0 };
        if self.floating {
            let part = |at: usize| Vector3::from_column_slice(&self.change[at..at + 3]) * scale;
            let at = model.bodies()[self.root.0].qpos_start;
            let q = &state.qpos[at..at + 7];
            let rotation = UnitQuaternion::new_normalize(Quaternion::new(q[3], q[4], q[5], q[6]));
            let position = Vector3::new(q[0], q[1], q[2]) + part(0);
            let world_from_root = Isometry3::from_parts(
                Translation3::from(position),
                UnitQuaternion::from_scaled_axis(part(3)) * rotation,
            );
            state.set_pose(model, self.root, &world_from_root);
        }
        for (variable, change) in self.variables.iter().zip(&self.change[first..]) {
            let (lower, upper) = self.range(variable);
            let angle = &mut state.qpos[variable.qpos];
            *angle = (*angle + scale * change).clamp(lower, upper);
        }
        model.follow_positions(state);
    }

    /// The obstacle between the posture and the goals: the joint at a limit that the error presses most against it.
    fn obstacle(&self, state: &State) -> Outcome {
        let (rows, first) = (self.error.len(), self.change.len() - self.variables.len());
        let mut most = (Outcome::OutOfReach, 1e-9);
        for (index, variable) in self.variables.iter().enumerate() {
            let press = dot(&self.jacobian[(first + index) * rows..][..rows], &self.error);
            let ((lower, upper), angle) = (self.range(variable), state.qpos[variable.qpos]);
            if (angle <= lower && press < 0.0 || angle >= upper && press > 0.0) && press.abs() > most.1 {
                most = (Outcome::Limit { body: variable.body }, press.abs());
            }
        }
        most.0
    }
}

fn copy(entries: &[usize], from: &[f64], to: &mut [f64]) {
    entries.iter().zip(to).for_each(|(entry, to)| *to = from[*entry]);
}
