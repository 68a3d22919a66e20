//! The Hessian of the objective, factorised: mass matrix, drives, limits, locks and contacts.

use super::body_pair::{force_of, stiffness_of};
use super::island::Island;
use super::{LOCK, Problem, Solver};
use crate::row_set::RowSet;

impl<const W: usize> Solver<W> {
    /// Builds and factorises the Hessian. Settled rows (in a humanoid: most of what does not stand on the floor, fingers
    /// above all) are not eliminated again.
    pub(super) fn factorise(&mut self, problem: &Problem<'_>, island: &Island<W>) -> bool {
        let &Problem { model, equation, input, dt, .. } = problem;
        if self.caution > 0.0 {
            for run in &island.drives {
                for drive in &self.drives[run.clone()] {
                    self.diagonal[drive.dof] += dt * drive.extra_stiffness(self.velocity[drive.dof], self.caution);
                }
            }
        }
        if !input.locked.is_empty() {
            for dof in island.rows.into_iter().filter(|&dof| input.locked[dof]) {
                self.diagonal[dof] += LOCK * equation.mass_matrix[model.diagonal(dof)];
            }
        }
        let mut changed = RowSet::EMPTY;
        for &pair in &island.pairs {
            let pair = &mut self.pairs[pair];
            let points = &mut self.points[pair.points.0..pair.points.1];
            if self.caution > 0.0 {
                points.iter_mut().for_each(|point| point.bound_stiffness(self.caution));
            }
            pair.stiffness = stiffness_of(points);
            if pair.stiffness.is_some() {
                changed |= pair.dofs;
            }
        }
        let first = (self.begun & island.rows).is_empty();
        if first {
            self.begun |= island.rows;
            self.settled |= island.rows;
        } else {
            for run in &island.dofs {
                let settled = self.settled_diagonal[run.clone()].iter().zip(&self.diagonal[run.clone()]);
                for (k, _) in settled.enumerate().filter(|(_, (settled, now))| settled != now) {
                    changed.insert(run.start + k);
                }
            }
        }
        let (twigs, factor, diagonal) = (&mut self.twigs, &mut self.factor, &self.diagonal);
        let rows = island.rows & !twigs.free();
        if first || !(changed & self.settled).is_empty() {
            self.settled &= !factor.reached_from(changed);
            self.settled &= !twigs.in_part(self.settled);
            let settled = self.settled & island.rows;
            factor.load(&equation.mass_matrix, rows);
            for run in &island.dofs {
                self.settled_diagonal[run.clone()].copy_from_slice(&diagonal[run.clone()]);
            }
            for dof in settled & rows {
                factor.add(dof, diagonal[dof]);
            }
            if !twigs.eliminate(settled, problem, diagonal, factor) || !factor.eliminate(settled & rows) {
                return false;
            }
            factor.keep(rows & !settled);
        } else {
            factor.restore(rows & !self.settled);
        }
        let rest = island.rows & !self.settled;
        if !twigs.eliminate(rest, problem, diagonal, factor) {
            return false;
        }
        self.add_stiffness(island, rest & rows);
        self.factor.eliminate(rest & rows)
    }

    /// Adds contacts, and what acts on the degrees of freedom of those rows.
    fn add_stiffness(&mut self, island: &Island<W>, rows: RowSet<W>) {
        for dof in rows {
            self.factor.add(dof, self.diagonal[dof]);
        }
        for &pair in &island.pairs {
            let pair = &self.pairs[pair];
            let Some(stiffness) = &pair.stiffness else { continue };
            let columns = &self.columns[pair.columns.0..pair.columns.1];
            let dofs = &self.column_dof[pair.columns.0..pair.columns.1];
            for (r, column) in columns.iter().enumerate() {
                let force = force_of(stiffness, column);
                self.factor.add_to_row(usize::from(dofs[r]), &dofs[..=r], |other| columns[other].dot(&force));
            }
        }
    }
}
