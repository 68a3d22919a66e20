//! The step length along Newton's direction.

use std::ops::Range;

use super::island::Island;
use super::{Problem, Solver};
use crate::factor::dot;
use crate::row_set::RowSet;

impl<const W: usize> Solver<W> {
    /// The objective's slope along the direction, by the gradient at hand.
    pub(super) fn slope(&self, island: &Island<W>) -> f64 {
        let of_run = |run: &Range<usize>| dot(&self.direction[run.clone()], &self.gradient[run.clone()]);
        island.dofs.iter().map(of_run).sum()
    }

    /// Step length at which the objective's slope along the direction is nearly zero, at most `flat`. The velocity at hand is
    /// that of the full step, where the slope is positive.
    pub(super) fn line_search(&self, problem: &Problem<'_>, island: &Island<W>, flat: f64) -> f64 {
        let &Problem { equation, dt, .. } = problem;
        let (mut constant, mut linear) = (0.0, 0.0);
        for run in &island.dofs {
            for dof in run.clone() {
                constant += self.direction[dof] * (self.momentum_change[dof] + dt * equation.bias[dof]);
                linear += self.direction[dof] * self.mass_direction[dof];
            }
        }
        // Terms that stay linear over the whole step are added up once; the bits are those of the others.
        let (mut bent_drives, mut bent_limits) = (RowSet::<W>::EMPTY, RowSet::<W>::EMPTY);
        for index in island.drives.iter().cloned().flatten() {
            let drive = &self.drives[index];
            let (v, d) = (self.velocity[drive.dof], self.direction[drive.dof]);
            match (drive.straight(v - d), drive.straight(v)) {
                (Some(_), Some((effort, stiffness))) => {
                    constant -= dt * effort * d;
                    linear += dt * stiffness * d * d;
                }
                _ => bent_drives.insert(index),
            }
        }
        for index in island.limits.iter().cloned().flatten() {
            let limit = &self.limits[index];
            let (v, d) = (self.velocity[limit.dof], self.direction[limit.dof]);
            if !(limit.allows(v - d) && limit.allows(v)) {
                bent_limits.insert(index);
            }
        }
        let slope_at = |step: f64| {
            let beyond = step - 1.0;
            let (mut slope, mut curvature) = (constant + beyond * linear, linear);
            for drive in bent_drives.into_iter().map(|index| &self.drives[index]) {
                let d = self.direction[drive.dof];
                let (effort, stiffness) = drive.effort(self.velocity[drive.dof] + beyond * d);
                slope -= dt * effort * d;
                curvature += dt * stiffness * d * d;
            }
            for limit in bent_limits.into_iter().map(|index| &self.limits[index]) {
                let d = self.direction[limit.dof];
                let (impulse, stiffness) = limit.impulse(self.velocity[limit.dof] + beyond * d);
                slope -= impulse * d;
                curvature += stiffness * d * d;
            }
            for &pair in &island.pairs {
                for point in &self.points[self.pairs[pair].points.0..self.pairs[pair].points.1] {
                    let (s, c) = point.slope(beyond);
                    slope += s;
                    curvature += c;
                }
            }
            (slope, curvature)
        };
        let (mut slope, mut curvature) = slope_at(1.0);
        let (mut low, mut high, mut step) = (0.0, 1.0, 1.0);
        for _ in 0..20 {
            let newton = step - slope / curvature;
            step = if newton > low && newton < high { newton } else { 0.5 * (low + high) };
            (slope, curvature) = slope_at(step);
            if slope.abs() <= flat {
                break;
            }
            if slope > 0.0 { high = step } else { low = step }
        }
        step
    }
}
