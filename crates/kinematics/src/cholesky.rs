//! A dense Cholesky factor, in place.

use fiatlux_dynamics::dot;

/// Factors a symmetric matrix of `n` rows into `L L'`; reads and writes the lower triangle alone. False if a pivot is not
/// positive: the matrix is not positive definite.
pub(crate) fn factor(matrix: &mut [f64], n: usize) -> bool {
    for i in 0..n {
        let (above, row) = matrix.split_at_mut(i * n);
        for j in 0..i {
            let other = &above[j * n..=j * n + j];
            row[j] = (row[j] - dot(&row[..j], &other[..j])) / other[j];
        }
        let pivot = row[i] - dot(&row[..i], &row[..i]);
        if !(pivot > 0.0 && pivot.is_finite()) {
            return false;
        }
        row[i] = pivot.sqrt();
    }
    true
}

/// Solves `L L' x = b` in place.
pub(crate) fn solve(factor: &[f64], n: usize, x: &mut [f64]) {
    for i in 0..n {
        let row = &factor[i * n..=i * n + i];
        x[i] = (x[i] - dot(&row[..i], &x[..i])) / row[i];
    }
    for i in (0..n).rev() {
        let row = &factor[i * n..=i * n + i];
        x[i] /= row[i];
        let (head, tail) = x.split_at_mut(i);
        add_scaled(head, &row[..i], -tail[0]);
    }
}

#[inline(always)]
pub(crate) fn add_scaled(target: &mut [f64], source: &[f64], scale: f64) {
    for (target, source) in target.iter_mut().zip(source) {
        *target += scale * source;
    }
}
