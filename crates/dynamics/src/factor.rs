//! `L^T D L` factor of a symmetric positive definite matrix whose rows follow the trees: eliminated from the leaves to the
//! roots it fills in only where contact couples two branches.

use crate::model::Model;
use crate::row_set::RowSet;

/// Lower triangle. A row holds its nonzero columns packed, the diagonal last. Along a branch without couplings the columns of
/// a row begin with those of each row that it is passed on to, so that elimination runs through memory.
#[derive(Debug, Clone)]
pub(crate) struct Factor<const W: usize> {
    n: usize,
    values: Vec<f64>,
    inverse_diagonal: Vec<f64>,
    /// Columns below the diagonal that each row holds in a tree without couplings.
    tree_pattern: Vec<RowSet<W>>,
    /// The same with this step's couplings and their fill-in.
    pattern: Vec<RowSet<W>>,
    rows: PatternRows,
    /// Rows as they were when they were last kept.
    kept: Vec<f64>,
}

/// The rows of both patterns; which of them holds is decided by the step's contacts.
#[derive(Debug, Clone)]
struct PatternRows {
    tree: Rows,
    coupled: Rows,
    is_coupled: bool,
}

impl PatternRows {
    fn in_force(&self) -> &Rows {
        if self.is_coupled { &self.coupled } else { &self.tree }
    }
}

/// Where the entries of each row stand.
#[derive(Debug, Clone)]
struct Rows {
    start: Vec<u32>,
    columns: Vec<u16>,
    /// Half-open runs of columns below the diagonal, ascending.
    runs: Vec<(u16, u16)>,
    first_run: Vec<u32>,
}

impl Rows {
    /// Memory for the worst case, so that no step has to grow it.
    fn new(n: usize) -> Self {
        Self {
            start: Vec::with_capacity(n + 1),
            columns: Vec::with_capacity(n * (n + 1) / 2),
            runs: Vec::with_capacity(n * (n / 2 + 1)),
            first_run: Vec::with_capacity(n + 1),
        }
    }

    fn range(&self, row: usize) -> std::ops::Range<usize> {
        self.start[row] as usize..self.start[row + 1] as usize
    }

    fn runs(&self, row: usize) -> &[(u16, u16)] {
        &self.runs[self.first_run[row] as usize..self.first_run[row + 1] as usize]
    }

    fn rebuild<const W: usize>(&mut self, pattern: &[RowSet<W>]) {
        self.start.clear();
        self.columns.clear();
        self.runs.clear();
        self.first_run.clear();
        self.start.push(0);
        self.first_run.push(0);
        for (row, &bits) in pattern.iter().enumerate() {
            let mut from = 0;
            while let Some(run) = bits.run_from(from) {
                from = run.end;
                let run = (run.start as u16, run.end as u16);
                self.runs.push(run);
                self.columns.extend(run.0..run.1);
            }
            self.columns.push(row as u16);
            self.start.push(self.columns.len() as u32);
            self.first_run.push(self.runs.len() as u32);
        }
    }
}

impl<const W: usize> Factor<W> {
    pub fn new(model: &Model) -> Self {
        let n = model.nv;
        let mut tree_pattern = vec![RowSet::EMPTY; n];
        for (dof, &body) in model.dof_body.iter().enumerate() {
            for &other in model.chains[body].iter().filter(|&&d| usize::from(d) < dof) {
                tree_pattern[dof].insert(usize::from(other));
            }
        }
        let (mut tree, coupled) = (Rows::new(n), Rows::new(n));
        tree.rebuild(&tree_pattern);
        Self {
            n,
            values: vec![0.0; n * (n + 1) / 2],
            kept: vec![0.0; n * (n + 1) / 2],
            inverse_diagonal: vec![0.0; n],
            pattern: tree_pattern.clone(),
            tree_pattern,
            rows: PatternRows { tree, coupled, is_coupled: false },
        }
    }

    /// Forgets the couplings of the step before.
    pub fn reset_pattern(&mut self) {
        if self.rows.is_coupled {
            self.pattern.copy_from_slice(&self.tree_pattern);
            self.rows.is_coupled = false;
        }
    }

    /// Notes that all degrees of freedom in the bit set are coupled with each other.
    pub fn couple(&mut self, dofs: RowSet<W>) {
        for dof in dofs {
            self.pattern[dof] |= dofs & RowSet::below(dof);
        }
        self.rows.is_coupled = true;
    }

    /// Works out the fill-in of all couplings: a row passes its columns on to the highest of them.
    pub fn finish_pattern(&mut self) {
        if !self.rows.is_coupled {
            return;
        }
        for row in (0..self.n).rev() {
            let bits = self.pattern[row];
            if let Some(top) = bits.last() {
                self.pattern[top] |= bits & RowSet::below(top);
            }
        }
        self.rows.coupled.rebuild(&self.pattern);
    }

    /// The rows that hold a change of any of `rows` after elimination: these, and all that elimination passes it on to.
    pub fn reached_from(&self, rows: RowSet<W>) -> RowSet<W> {
        let (mut reached, mut rest) = (rows, rows);
        while let Some(row) = rest.last() {
            reached |= self.pattern[row];
            rest = reached & RowSet::below(row);
        }
        reached
    }

    /// Starts rows from a matrix in the trees' pattern, packed as [`Model`] says.
    pub fn load(&mut self, matrix: &[f64], rows: RowSet<W>) {
        let (tree, in_force) = (&self.rows.tree, self.rows.in_force());
        for row in rows {
            let (from, to) = (tree.range(row), in_force.range(row));
            let (source, target) = (&matrix[from.clone()], &mut self.values[to.clone()]);
            if from.len() == to.len() {
                target.copy_from_slice(source);
            } else {
                target.fill(0.0);
                let mut places = Places::new(&in_force.columns[to]);
                for (&column, &value) in tree.columns[from].iter().zip(source) {
                    target[places.of(column)] = value;
                }
            }
        }
    }

    /// Remembers rows as they are.
    pub fn keep(&mut self, rows: RowSet<W>) {
        copy_rows(self.rows.in_force(), rows, &self.values, &mut self.kept);
    }

    /// Takes rows back to what they were when they were kept.
    pub fn restore(&mut self, rows: RowSet<W>) {
        copy_rows(self.rows.in_force(), rows, &self.kept, &mut self.values);
    }

    /// Adds to the diagonal.
    #[inline(always)]
    pub fn add(&mut self, row: usize, value: f64) {
        let diagonal = self.rows.in_force().start[row + 1] as usize - 1;
        self.values[diagonal] += value;
    }

    /// Adds to entries of a row that the pattern holds; columns ascend.
    #[inline(always)]
    pub fn add_to_row(&mut self, row: usize, columns: &[u16], value: impl Fn(usize) -> f64) {
        let range = self.rows.in_force().range(row);
        let target = &mut self.values[range.clone()];
        if target.len() == columns.len() {
            for (which, entry) in target.iter_mut().enumerate() {
                *entry += value(which);
            }
        } else {
            let mut places = Places::new(&self.rows.in_force().columns[range]);
            for (which, &column) in columns.iter().enumerate() {
                target[places.of(column)] += value(which);
            }
        }
    }

    /// Eliminates rows. Whatever they pass on goes to rows that are eliminated with them or later. False if a pivot is not
    /// positive: the matrix was not positive definite.
    pub fn eliminate(&mut self, rows: RowSet<W>) -> bool {
        let mut positive = true;
        let in_force = self.rows.in_force();
        let mut rest = rows;
        while let Some(k) = rest.last() {
            rest.remove(k);
            let range = in_force.range(k);
            let columns = &in_force.columns[range.clone()];
            let below = range.len() - 1;
            // Two links of a branch at once, where the columns of one are those of the other and that other.
            let parent = k.wrapping_sub(1);
            let two = below > 0
                && usize::from(columns[below - 1]) == parent
                && rest.contains(parent)
                && in_force.range(parent).len() == below;
            if two {
                rest.remove(parent);
                let (above, both) = self.values.split_at_mut(range.start - below);
                let (next, row) = both.split_at_mut(below);
                let row = &mut row[..=below];
                let inverse = 1.0 / row[below];
                subtract_scaled(next, &row[..below], row[below - 1] * inverse);
                let next_inverse = 1.0 / next[below - 1];
                positive &= row[below] > 0.0 && next[below - 1] > 0.0;
                self.inverse_diagonal[k] = inverse;
                self.inverse_diagonal[parent] = next_inverse;
                for which in 0..below - 1 {
                    let target_range = in_force.range(usize::from(columns[which]));
                    let target = &mut above[target_range.clone()];
                    let scales = [row[which] * inverse, next[which] * next_inverse];
                    if target.len() == which + 1 {
                        subtract_two_scaled(target, [&row[..=which], &next[..=which]], scales);
                    } else {
                        let mut places = Places::new(&in_force.columns[target_range]);
                        for (i, &column) in columns[..=which].iter().enumerate() {
                            target[places.of(column)] -= scales[0] * row[i] + scales[1] * next[i];
                        }
                    }
                }
                row[..below].iter_mut().for_each(|value| *value *= inverse);
                next[..below - 1].iter_mut().for_each(|value| *value *= next_inverse);
                continue;
            }
            let (above, row) = self.values.split_at_mut(range.start);
            let row = &mut row[..=below];
            let inverse = 1.0 / row[below];
            positive &= row[below] > 0.0;
            self.inverse_diagonal[k] = inverse;
            for which in 0..below {
                let target_range = in_force.range(usize::from(columns[which]));
                let target = &mut above[target_range.clone()];
                let scale = row[which] * inverse;
                if target.len() == which + 1 {
                    subtract_scaled(target, &row[..=which], scale);
                } else {
                    let mut places = Places::new(&in_force.columns[target_range]);
                    for (&column, &value) in columns[..=which].iter().zip(&row[..=which]) {
                        target[places.of(column)] -= scale * value;
                    }
                }
            }
            row[..below].iter_mut().for_each(|value| *value *= inverse);
        }
        positive
    }

    /// Solves for the rows of `x` in place; no other row is coupled with them.
    pub fn solve(&self, x: &mut [f64], rows: RowSet<W>) {
        let in_force = self.rows.in_force();
        for k in rows.into_iter().rev() {
            let (head, tail) = x.split_at_mut(k);
            let value = tail[0];
            let mut entries = &self.values[in_force.range(k)];
            for &(start, end) in in_force.runs(k) {
                let target = &mut head[usize::from(start)..usize::from(end)];
                let (run, rest) = entries.split_at(target.len());
                subtract_scaled(target, run, value);
                entries = rest;
            }
            tail[0] *= self.inverse_diagonal[k];
        }
        for k in rows {
            let mut value = x[k];
            let mut entries = &self.values[in_force.range(k)];
            for &(start, end) in in_force.runs(k) {
                let source = &x[usize::from(start)..usize::from(end)];
                let (run, rest) = entries.split_at(source.len());
                value -= dot(run, source);
                entries = rest;
            }
            x[k] = value;
        }
    }
}

/// Finds ascending columns among those of a row.
struct Places<'a> {
    columns: &'a [u16],
    place: usize,
}

impl<'a> Places<'a> {
    fn new(columns: &'a [u16]) -> Self {
        Self { columns, place: 0 }
    }

    #[inline(always)]
    fn of(&mut self, column: u16) -> usize {
        while self.columns[self.place] != column {
            self.place += 1;
        }
        self.place
    }
}

fn copy_rows<const W: usize>(in_force: &Rows, rows: RowSet<W>, from: &[f64], to: &mut [f64]) {
    for row in rows {
        let range = in_force.range(row);
        to[range.clone()].copy_from_slice(&from[range]);
    }
}

#[inline(always)]
fn subtract_scaled(target: &mut [f64], source: &[f64], scale: f64) {
    let (targets, target_rest) = target.as_chunks_mut::<4>();
    let (sources, source_rest) = source.as_chunks::<4>();
    for (t, s) in targets.iter_mut().zip(sources) {
        // All reads before the writes, for vector instructions.
        *t = std::array::from_fn(|i| t[i] - scale * s[i]);
    }
    for (t, s) in target_rest.iter_mut().zip(source_rest) {
        *t -= scale * s;
    }
}

#[inline(always)]
fn subtract_two_scaled(target: &mut [f64], sources: [&[f64]; 2], scales: [f64; 2]) {
    let (targets, target_rest) = target.as_chunks_mut::<4>();
    let ((a, a_rest), (b, b_rest)) = (sources[0].as_chunks::<4>(), sources[1].as_chunks::<4>());
    for (t, (a, b)) in targets.iter_mut().zip(a.iter().zip(b)) {
        *t = std::array::from_fn(|i| t[i] - (scales[0] * a[i] + scales[1] * b[i]));
    }
    for (t, (a, b)) in target_rest.iter_mut().zip(a_rest.iter().zip(b_rest)) {
        *t -= scales[0] * a + scales[1] * b;
    }
}

/// Product of two arrays of one length, summed in four lanes so that it vectorises; the order of sums is fixed.
#[inline(always)]
pub fn dot(a: &[f64], b: &[f64]) -> f64 {
    let (a_chunks, a_rest) = a.as_chunks::<4>();
    let (b_chunks, b_rest) = b.as_chunks::<4>();
    let mut lanes = [0.0; 4];
    for (a, b) in a_chunks.iter().zip(b_chunks) {
        for i in 0..4 {
            lanes[i] += a[i] * b[i];
        }
    }
    let rest: f64 = a_rest.iter().zip(b_rest).map(|(a, b)| a * b).sum();
    (lanes[0] + lanes[2]) + (lanes[1] + lanes[3]) + rest
}
