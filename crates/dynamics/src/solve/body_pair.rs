//! The contacts between two bodies as one term of the objective.

use crate::contact_law::Point;
use crate::row_set::RowSet;
use crate::spatial::{Force, Motion, V3};

/// The contacts between two bodies: they share one relative motion, a sum of columns over degrees of freedom.
#[derive(Debug, Clone, Copy)]
pub(crate) struct BodyPair<const W: usize> {
    /// The second body, which moves.
    pub body: usize,
    /// Ranges of the solver's points and columns.
    pub points: (usize, usize),
    pub columns: (usize, usize),
    /// The columns' degrees of freedom.
    pub dofs: RowSet<W>,
    /// From relative motion to force; none while no point is loaded.
    pub stiffness: Option<[[f64; 6]; 6]>,
}

impl<const W: usize> BodyPair<W> {
    /// Motion of the second body relative to the first when the degrees of freedom move at `velocity`.
    pub fn relative_motion(&self, columns: &[Motion], column_dof: &[u16], velocity: &[f64]) -> Motion {
        let mut motion = Motion::ZERO;
        for k in self.columns.0..self.columns.1 {
            motion.add_scaled(&columns[k], velocity[usize::from(column_dof[k])]);
        }
        motion
    }
}

/// Sum of the points' stiffnesses as a matrix from relative motion to force; none if no point is loaded.
pub(crate) fn stiffness_of(points: &[Point]) -> Option<[[f64; 6]; 6]> {
    let mut sum = [[0.0; 6]; 6];
    let mut loaded = false;
    for point in points {
        let g = &point.stiffness;
        if g[5] == 0.0 {
            continue;
        }
        loaded = true;
        if let Some(spin) = &point.spin {
            point.add_spin_stiffness(spin, &mut sum);
            continue;
        }
        let flat = |f: &Force| [f.torque.x, f.torque.y, f.torque.z, f.force.x, f.force.y, f.force.z];
        let rows = [flat(&point.rows[0]), flat(&point.rows[1]), flat(&point.rows[2])];
        let mut scaled = [[0.0; 6]; 3];
        for c in 0..6 {
            scaled[0][c] = g[0] * rows[0][c] + g[1] * rows[1][c] + g[3] * rows[2][c];
            scaled[1][c] = g[1] * rows[0][c] + g[2] * rows[1][c] + g[4] * rows[2][c];
            scaled[2][c] = g[3] * rows[0][c] + g[4] * rows[1][c] + g[5] * rows[2][c];
        }
        for r in 0..6 {
            for c in 0..6 {
                sum[r][c] += rows[0][r] * scaled[0][c] + rows[1][r] * scaled[1][c] + rows[2][r] * scaled[2][c];
            }
        }
    }
    loaded.then_some(sum)
}

pub(crate) fn force_of(stiffness: &[[f64; 6]; 6], m: &Motion) -> Force {
    let v = [m.angular.x, m.angular.y, m.angular.z, m.linear.x, m.linear.y, m.linear.z];
    let mut out = [0.0; 6];
    // The matrix is symmetric: columns times scalars vectorise, rows times the vector do not.
    for (row, value) in stiffness.iter().zip(v) {
        for c in 0..6 {
            out[c] += row[c] * value;
        }
    }
    Force { torque: V3::new(out[0], out[1], out[2]), force: V3::new(out[3], out[4], out[5]) }
}
