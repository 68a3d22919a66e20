//! A solver for small dense quadratic programs: the dual active-set method of Goldfarb and Idnani.
//!
//! It starts at the minimum without constraints and adds the most violated one after another, each time along the direction
//! that keeps the others; where the multiplier of an inequality would turn negative on the way, that one is dropped. Each
//! step raises the dual, so it ends at the minimum or at a constraint that cannot be met.
//!
//! D. Goldfarb, A. Idnani, A numerically stable dual method for solving strictly convex quadratic programs, Mathematical
//! Programming 27, 1983.

use fiatlux_dynamics::dot;
use thiserror::Error;

use crate::cholesky::{add_scaled, factor};

/// Violations below this, of a row of length 1 and relative to the numbers in it, count as met.
const TOLERANCE: f64 = 1e-11;
/// A row whose part across the active ones is smaller than this, relative to all of it, depends on them: the corners of a sole
/// that lie in a plane but for micrometres.
const DEPENDENT: f64 = 1e-6;

/// Minimise `x' H x / 2 + g' x`, where the first rows hold `row x = bound` and the others `row x >= bound`. Matrices are
/// row-major.
#[derive(Debug, Clone, Copy)]
pub struct Program<'a> {
    /// `n` rows of `n` numbers, positive definite; the lower triangle is read.
    pub hessian: &'a [f64],
    /// `n` numbers.
    pub gradient: &'a [f64],
    /// `m` rows of `n` numbers.
    pub rows: &'a [f64],
    /// `m` numbers.
    pub bounds: &'a [f64],
    /// Number of equalities among the rows; they come first.
    pub equalities: usize,
}

/// Why a program has no solution.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
#[allow(missing_docs)] // The messages say it.
pub enum ProgramError {
    #[error("the Hessian is not positive definite; add to its diagonal")]
    NotConvex,
    #[error("no point meets row {row} together with the rows before it; relax a bound")]
    Infeasible { row: usize },
    #[error("the solver did not finish; check that all numbers are finite and rows of similar length")]
    Stalled,
}

/// Scratch memory of the solver, which grows with the largest program and is reused: a solve of a size that was seen before
/// allocates nothing. No solve depends on the one before.
#[derive(Debug, Clone, Default)]
pub struct ProgramSolver {
    n: usize,
    factor: Vec<f64>,
    /// Columns of `J`: the inverse transposed factor times an orthogonal matrix whose first columns span the active rows.
    j: Vec<f64>,
    /// Columns of the triangular `R`, `n` numbers each: the active rows in the terms of `J`.
    r: Vec<f64>,
    norms: Vec<f64>,
    is_active: Vec<bool>,
    /// Active rows, and their multipliers with that of the row that is being added.
    active: Vec<usize>,
    multipliers: Vec<f64>,
    /// A row in the terms of `J`, the primal and the dual direction.
    d: Vec<f64>,
    z: Vec<f64>,
    dual: Vec<f64>,
}

impl ProgramSolver {
    /// Finds the minimum and returns in how many steps.
    ///
    /// # Errors
    /// [`ProgramError`]; `x` then means nothing.
    ///
    /// # Panics
    /// If an array does not have the length that follows from `x` and the bounds.
    pub fn solve(&mut self, program: &Program<'_>, x: &mut [f64]) -> Result<usize, ProgramError> {
        let (n, m) = (x.len(), program.bounds.len());
        assert!(program.hessian.len() == n * n && program.gradient.len() == n, "n rows and n numbers");
        assert!(program.rows.len() == n * m && program.equalities <= m, "a row of n numbers for each bound");
        self.reset(program, n, m)?;
        for column in 0..n {
            let along = dot(&self.j[column * n..][..n], program.gradient);
            self.d[column] = -along;
        }
        x.fill(0.0);
        for column in 0..n {
            add_scaled(x, &self.j[column * n..][..n], self.d[column]);
        }
        for row in 0..program.equalities {
            self.meet_equality(program, row, x)?;
        }
        let most = 50 + 10 * (n + m);
        for step in 0..most {
            let Some(row) = self.most_violated(program, x) else {
                return if x.iter().all(|value| value.is_finite()) { Ok(step) } else { Err(ProgramError::Stalled) };
            };
            self.meet_inequality(program, row, x)?;
        }
        Err(ProgramError::Stalled)
    }

    fn reset(&mut self, program: &Program<'_>, n: usize, m: usize) -> Result<(), ProgramError> {
        self.n = n;
        for square in [&mut self.factor, &mut self.j, &mut self.r] {
            square.clear();
            square.resize(n * n, 0.0);
        }
        for line in [&mut self.d, &mut self.z, &mut self.dual] {
            line.resize(n, 0.0);
        }
        self.active.clear();
        self.active.reserve(n);
        self.multipliers.clear();
        self.multipliers.reserve(n + 1);
        self.is_active.clear();
        self.is_active.resize(m, false);
        self.norms.clear();
        self.norms.extend(program.rows.chunks(n.max(1)).map(|row| dot(row, row).sqrt()));
        self.factor.copy_from_slice(program.hessian);
        if !factor(&mut self.factor, n) {
            return Err(ProgramError::NotConvex);
        }
        // Columns of the inverse transposed factor are rows of its inverse, each from those before.
        for row in 0..n {
            let (before, own) = self.j.split_at_mut(row * n);
            let line = &self.factor[row * n..=row * n + row];
            for (k, entry) in line[..row].iter().enumerate() {
                add_scaled(&mut own[..=k], &before[k * n..=k * n + k], -entry);
            }
            own[row] = 1.0;
            own[..=row].iter_mut().for_each(|value| *value /= line[row]);
        }
        Ok(())
    }

    /// Distance of a row from its bound, negative where it is violated.
    fn slack(&self, program: &Program<'_>, row: usize, x: &[f64]) -> f64 {
        dot(&program.rows[row * self.n..][..self.n], x) - program.bounds[row]
    }

    /// Slack below which a row counts as violated.
    fn allowed(&self, program: &Program<'_>, row: usize, x: &[f64]) -> f64 {
        let size = x.iter().fold(0.0_f64, |most, value| most.max(value.abs()));
        TOLERANCE * (self.norms[row] * size + program.bounds[row].abs())
    }

    fn most_violated(&self, program: &Program<'_>, x: &[f64]) -> Option<usize> {
        let mut worst = (None, 0.0);
        for row in (program.equalities..program.bounds.len()).filter(|row| !self.is_active[*row]) {
            let slack = self.slack(program, row, x);
            let violation = -slack / self.norms[row].max(f64::MIN_POSITIVE);
            if violation > worst.1 && slack < -self.allowed(program, row, x) {
                worst = (Some(row), violation);
            }
        }
        worst.0
    }

    /// Directions that meeting a row takes: `z` for the point, `dual` for the multipliers. Returns the rate at which the row's
    /// slack grows along `z`; none where the row depends on the active ones.
    fn direct(&mut self, program: &Program<'_>, row: usize) -> Option<f64> {
        let (n, active) = (self.n, self.active.len());
        let line = &program.rows[row * n..][..n];
        for column in 0..n {
            self.d[column] = dot(&self.j[column * n..][..n], line);
        }
        self.z.fill(0.0);
        for column in active..n {
            add_scaled(&mut self.z, &self.j[column * n..][..n], self.d[column]);
        }
        self.dual[..active].copy_from_slice(&self.d[..active]);
        for column in (0..active).rev() {
            let own = &self.r[column * n..][..n];
            let (head, tail) = self.dual.split_at_mut(column);
            tail[0] /= own[column];
            add_scaled(head, &own[..column], -tail[0]);
        }
        let (rate, all) = (dot(&self.d[active..], &self.d[active..]), dot(&self.d, &self.d));
        (rate > DEPENDENT * DEPENDENT * all).then_some(rate)
    }

    fn meet_equality(&mut self, program: &Program<'_>, row: usize, x: &mut [f64]) -> Result<(), ProgramError> {
        let slack = self.slack(program, row, x);
        let Some(rate) = self.direct(program, row) else {
            // Repeats the rows before it, or contradicts them.
            let met = slack.abs() <= 1e3 * self.allowed(program, row, x);
            return if met { Ok(()) } else { Err(ProgramError::Infeasible { row }) };
        };
        let step = -slack / rate;
        add_scaled(x, &self.z, step);
        self.move_multipliers(step);
        self.multipliers.push(step);
        self.add(row);
        Ok(())
    }

    fn meet_inequality(&mut self, program: &Program<'_>, row: usize, x: &mut [f64]) -> Result<(), ProgramError> {
        let mut multiplier = 0.0;
        loop {
            let rate = self.direct(program, row);
            let full = rate.map_or(f64::INFINITY, |rate| -self.slack(program, row, x) / rate);
            // The first inequality whose multiplier would turn negative.
            let (mut blocked, mut most) = (None, full);
            for (at, &other) in self.active.iter().enumerate().filter(|(_, other)| **other >= program.equalities) {
                debug_assert!(self.is_active[other]);
                if self.dual[at] > 0.0 && self.multipliers[at] / self.dual[at] < most {
                    (blocked, most) = (Some(at), self.multipliers[at] / self.dual[at]);
                }
            }
            if most == f64::INFINITY {
                return Err(ProgramError::Infeasible { row });
            }
            if rate.is_some() {
                add_scaled(x, &self.z, most);
            }
            self.move_multipliers(most);
            multiplier += most;
            let Some(at) = blocked else {
                self.multipliers.push(multiplier);
                self.add(row);
                return Ok(());
            };
            self.drop(at);
        }
    }

    fn move_multipliers(&mut self, step: f64) {
        let active = self.active.len();
        add_scaled(&mut self.multipliers, &self.dual[..active], -step);
    }

    /// Makes the row of the last [`Self::direct`] active.
    fn add(&mut self, row: usize) {
        let (n, active) = (self.n, self.active.len());
        for column in (active + 1..n).rev() {
            let (c, s, length) = rotation(self.d[column - 1], self.d[column]);
            self.d[column - 1] = length;
            turn(&mut self.j, n, column - 1, c, s);
        }
        self.r[active * n..][..=active].copy_from_slice(&self.d[..=active]);
        self.is_active[row] = true;
        self.active.push(row);
    }

    /// Makes the row at a place of the active ones inactive.
    fn drop(&mut self, at: usize) {
        let n = self.n;
        self.is_active[self.active.remove(at)] = false;
        self.multipliers.remove(at);
        for column in at..self.active.len() {
            self.r.copy_within((column + 1) * n..(column + 1) * n + column + 2, column * n);
        }
        for column in at..self.active.len() {
            let (c, s, length) = rotation(self.r[column * n + column], self.r[column * n + column + 1]);
            self.r[column * n + column] = length;
            for later in column + 1..self.active.len() {
                let pair = &mut self.r[later * n + column..][..2];
                (pair[0], pair[1]) = (c * pair[0] + s * pair[1], c * pair[1] - s * pair[0]);
            }
            turn(&mut self.j, n, column, c, s);
        }
    }
}

/// Cosine, sine and length of the turn that takes `(a, b)` to `(length, 0)`.
fn rotation(a: f64, b: f64) -> (f64, f64, f64) {
    if b == 0.0 {
        return (1.0, 0.0, a);
    }
    let length = libm::hypot(a, b);
    (a / length, b / length, length)
}

/// Turns a column and the next one.
fn turn(columns: &mut [f64], n: usize, first: usize, c: f64, s: f64) {
    if s == 0.0 {
        return;
    }
    let (a, b) = columns[first * n..][..2 * n].split_at_mut(n);
    for (a, b) in a.iter_mut().zip(b) {
        (*a, *b) = (c * *a + s * *b, c * *b - s * *a);
    }
}
