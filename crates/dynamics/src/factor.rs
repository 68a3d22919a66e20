//! `L^T D L` factor of a symmetric positive definite matrix whose rows follow the trees: eliminated from the leaves to the
//! roots it fills in only where contact couples two branches.

use crate::model::Model;

/// Lower triangle, row-major with `n` columns. A row's nonzero columns are a bit set and, for speed, runs of columns.
#[derive(Debug, Clone)]
pub(crate) struct Factor {
    n: usize,
    values: Vec<f64>,
    inverse_diagonal: Vec<f64>,
    /// Columns below the diagonal that each row holds in a tree without couplings.
    tree_pattern: Vec<u128>,
    /// The same with this step's couplings and their fill-in.
    pattern: Vec<u128>,
    runs: PatternRuns,
    /// Rows from here on are eliminated first and hold most of the work.
    split: usize,
    /// Rows before the split as they are when those after it have been eliminated.
    early_rows: Vec<f64>,
}

/// The runs of both patterns; which of them holds is decided by the step's contacts.
#[derive(Debug, Clone)]
struct PatternRuns {
    tree: Runs,
    coupled: Runs,
    is_coupled: bool,
}

impl PatternRuns {
    fn in_force(&self) -> &Runs {
        if self.is_coupled { &self.coupled } else { &self.tree }
    }
}

/// Half-open column runs of every row, ascending.
#[derive(Debug, Clone, Default)]
struct Runs {
    runs: Vec<(u16, u16)>,
    first: Vec<u32>,
}

impl Runs {
    fn of(&self, row: usize) -> &[(u16, u16)] {
        &self.runs[self.first[row] as usize..self.first[row + 1] as usize]
    }

    fn rebuild(&mut self, pattern: &[u128]) {
        self.runs.clear();
        self.first.clear();
        self.first.push(0);
        for &bits in pattern {
            let (mut rest, mut shift) = (bits, 0);
            while rest != 0 {
                let zeros = rest.trailing_zeros();
                let ones = (rest >> zeros).trailing_ones();
                self.runs.push(((shift + zeros) as u16, (shift + zeros + ones) as u16));
                shift += zeros + ones;
                rest = if shift == 128 { 0 } else { bits >> shift };
            }
            self.first.push(self.runs.len() as u32);
        }
    }
}

impl Factor {
    pub fn new(model: &Model) -> Self {
        let n = model.nv;
        let mut tree_pattern = vec![0_u128; n];
        for (dof, &body) in model.dof_body.iter().enumerate() {
            for &other in model.chains[body].iter().filter(|&&d| usize::from(d) < dof) {
                tree_pattern[dof] |= 1 << other;
            }
        }
        let mut tree = Runs::default();
        tree.rebuild(&tree_pattern);
        // Room for the worst case, so that no step has to grow it.
        let coupled = Runs { runs: Vec::with_capacity(n * (n / 2 + 1)), first: Vec::with_capacity(n + 1) };
        let work = |row: &u128| u64::from(row.count_ones()).pow(2);
        let total: u64 = tree_pattern.iter().map(work).sum();
        let late = |row: &usize| tree_pattern[*row..].iter().map(work).sum::<u64>() * 10 <= total * 7;
        let split = (0..n).find(late).unwrap_or(n);
        Self {
            split,
            early_rows: vec![0.0; split * n],
            n,
            values: vec![0.0; n * n],
            inverse_diagonal: vec![0.0; n],
            pattern: tree_pattern.clone(),
            tree_pattern,
            runs: PatternRuns { tree, coupled, is_coupled: false },
        }
    }

    /// Forgets the couplings of the step before.
    pub fn reset_pattern(&mut self) {
        if self.runs.is_coupled {
            self.pattern.copy_from_slice(&self.tree_pattern);
            self.runs.is_coupled = false;
        }
    }

    /// Notes that all degrees of freedom in the bit set are coupled with each other.
    pub fn couple(&mut self, dofs: u128) {
        let mut rest = dofs;
        while rest != 0 {
            let dof = rest.trailing_zeros();
            rest &= rest - 1;
            self.pattern[dof as usize] |= dofs & ((1 << dof) - 1);
        }
        self.runs.is_coupled = true;
    }

    /// Works out the fill-in of all couplings: a row passes its columns on to the highest of them.
    pub fn finish_pattern(&mut self) {
        if !self.runs.is_coupled {
            return;
        }
        for row in (0..self.n).rev() {
            let bits = self.pattern[row];
            if bits != 0 {
                let top = 127 - bits.leading_zeros();
                self.pattern[top as usize] |= bits & ((1 << top) - 1);
            }
        }
        self.runs.coupled.rebuild(&self.pattern);
    }

    /// Starts from a matrix that is zero outside the trees' pattern.
    pub fn load(&mut self, matrix: &[f64], rows: impl Iterator<Item = usize>) {
        copy_rows(self.n, self.runs.in_force(), rows, matrix, &mut self.values);
    }

    /// Adds to an entry of the lower triangle that the pattern holds.
    #[inline(always)]
    pub fn add(&mut self, row: usize, column: usize, value: f64) {
        debug_assert!(
            row == column || self.pattern[row] >> column & 1 == 1,
            "({row}, {column}) is outside the pattern"
        );
        self.values[row * self.n + column] += value;
    }

    /// One row of the lower triangle, to add to.
    #[inline(always)]
    pub fn row_mut(&mut self, row: usize) -> &mut [f64] {
        &mut self.values[row * self.n..row * self.n + row + 1]
    }

    /// First of the rows that [`Factor::eliminate_late`] takes.
    pub fn split(&self) -> usize {
        self.split
    }

    /// Eliminates the rows from the split on and keeps what that leaves of those before it. False if a pivot is not
    /// positive: the matrix was not positive definite.
    pub fn eliminate_late(&mut self, rows: impl DoubleEndedIterator<Item = usize> + Clone) -> bool {
        let split = self.split;
        let positive = self.eliminate(rows.clone().rev().take_while(|&row| row >= split));
        copy_rows(
            self.n,
            self.runs.in_force(),
            rows.take_while(|&row| row < split),
            &self.values,
            &mut self.early_rows,
        );
        positive
    }

    /// Goes back to the rows that [`Factor::eliminate_late`] left.
    pub fn restore_early(&mut self, rows: impl Iterator<Item = usize>) {
        let split = self.split;
        copy_rows(
            self.n,
            self.runs.in_force(),
            rows.take_while(|&row| row < split),
            &self.early_rows,
            &mut self.values,
        );
    }

    /// Eliminates the rows before the split; the factor is complete then.
    pub fn eliminate_early(&mut self, rows: impl DoubleEndedIterator<Item = usize>) -> bool {
        let split = self.split;
        self.eliminate(rows.rev().skip_while(|&row| row >= split))
    }

    /// Rows descending.
    fn eliminate(&mut self, rows: impl Iterator<Item = usize>) -> bool {
        let n = self.n;
        let mut positive = true;
        let runs = self.runs.in_force();
        for k in rows {
            let (above, row) = self.values.split_at_mut(k * n);
            let row = &mut row[..=k];
            let pivot = row[k];
            positive &= pivot > 0.0;
            let inverse = 1.0 / pivot;
            self.inverse_diagonal[k] = inverse;
            let row_runs = runs.of(k);
            for (which, &(start, end)) in row_runs.iter().enumerate() {
                for j in usize::from(start)..usize::from(end) {
                    let scale = row[j] * inverse;
                    let target = &mut above[j * n..j * n + j + 1];
                    for &(s, e) in &row_runs[..which] {
                        let (s, e) = (usize::from(s), usize::from(e));
                        subtract_scaled(&mut target[s..e], &row[s..e], scale);
                    }
                    let s = usize::from(start);
                    subtract_scaled(&mut target[s..=j], &row[s..=j], scale);
                }
            }
            for &(start, end) in row_runs {
                for value in &mut row[usize::from(start)..usize::from(end)] {
                    *value *= inverse;
                }
            }
        }
        positive
    }

    /// Solves for the rows of `x` in place; no other row is coupled with them.
    pub fn solve(&self, x: &mut [f64], rows: impl DoubleEndedIterator<Item = usize> + Clone) {
        let n = self.n;
        let runs = self.runs.in_force();
        for k in rows.clone().rev() {
            let (head, tail) = x.split_at_mut(k);
            let value = tail[0];
            for &(start, end) in runs.of(k) {
                let (s, e) = (usize::from(start), usize::from(end));
                subtract_scaled(&mut head[s..e], &self.values[k * n + s..k * n + e], value);
            }
            tail[0] *= self.inverse_diagonal[k];
        }
        for k in rows {
            let mut value = x[k];
            for &(start, end) in runs.of(k) {
                for j in usize::from(start)..usize::from(end) {
                    value -= self.values[k * n + j] * x[j];
                }
            }
            x[k] = value;
        }
    }

    /// Rows of `y = M x` for a matrix in the trees' pattern (not this factor).
    pub fn multiply(&self, matrix: &[f64], x: &[f64], y: &mut [f64], rows: impl Iterator<Item = usize>) {
        let n = self.n;
        for k in rows {
            let row = &matrix[k * n..k * n + k + 1];
            let value = x[k];
            let mut sum = row[k] * value;
            for &(start, end) in self.runs.tree.of(k) {
                for j in usize::from(start)..usize::from(end) {
                    sum += row[j] * x[j];
                    y[j] += row[j] * value;
                }
            }
            y[k] = sum;
        }
    }
}

/// Copies the entries of rows that the pattern has.
fn copy_rows(n: usize, runs: &Runs, rows: impl Iterator<Item = usize>, from: &[f64], to: &mut [f64]) {
    for row in rows {
        let start = row * n;
        for &(first, end) in runs.of(row) {
            let entries = start + usize::from(first)..start + usize::from(end);
            to[entries.clone()].copy_from_slice(&from[entries]);
        }
        to[start + row] = from[start + row];
    }
}

#[inline(always)]
fn subtract_scaled(target: &mut [f64], source: &[f64], scale: f64) {
    for (t, s) in target.iter_mut().zip(source) {
        *t -= scale * s;
    }
}
