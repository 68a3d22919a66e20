//! Trees that contact couples in a step. What does not touch is minimised apart: a ladder that stands still takes no part in
//! the iterations of a robot that moves.

use std::ops::Range;

use crate::joint_forces::{ImplicitDrive, JointLimit};
use crate::model::Model;
use crate::row_set::RowSet;
use crate::spec::BodyId;

/// One minimisation: a set of trees.
#[derive(Debug, Clone)]
pub(crate) struct Island<const W: usize> {
    /// Runs of degrees of freedom, ascending.
    pub dofs: Vec<Range<usize>>,
    /// The drives and the joint limits of each run.
    pub drives: Vec<Range<usize>>,
    pub limits: Vec<Range<usize>>,
    /// Every degree of freedom.
    pub rows: RowSet<W>,
    /// Indices of the solver's body pairs, ascending.
    pub pairs: Vec<usize>,
}

impl<const W: usize> Default for Island<W> {
    fn default() -> Self {
        Self { dofs: Vec::new(), drives: Vec::new(), limits: Vec::new(), rows: RowSet::EMPTY, pairs: Vec::new() }
    }
}

/// The islands of one step; memory stays from step to step.
#[derive(Debug, Clone)]
pub(crate) struct Islands<const W: usize> {
    /// Tree of each body and runs of each tree's degrees of freedom.
    tree_of_body: Vec<usize>,
    /// Root of each tree.
    roots: Vec<usize>,
    tree_dofs: Vec<Vec<Range<usize>>>,
    tree_rows: Vec<RowSet<W>>,
    /// For each tree one that it is coupled with, lower or itself.
    joined: Vec<usize>,
    /// One for each tree; that of a tree which another one takes in is empty.
    slots: Vec<Island<W>>,
}

impl<const W: usize> Islands<W> {
    pub fn new(model: &Model, pairs: usize) -> Self {
        let roots: Vec<usize> = (1..model.bodies.len()).filter(|&body| model.bodies[body].spec.parent.0 == 0).collect();
        let tree_of = |root: BodyId| roots.iter().position(|&r| r == root.0).unwrap_or(0);
        let tree_of_body = model.bodies.iter().map(|body| tree_of(body.root)).collect::<Vec<_>>();
        let mut tree_dofs = vec![Vec::<Range<usize>>::new(); roots.len()];
        let mut tree_rows = vec![RowSet::EMPTY; roots.len()];
        for (dof, &body) in model.dof_body.iter().enumerate() {
            tree_rows[tree_of_body[body]].insert(dof);
            let runs = &mut tree_dofs[tree_of_body[body]];
            match runs.last_mut() {
                Some(run) if run.end == dof => run.end += 1,
                _ => runs.push(dof..dof + 1),
            }
        }
        let runs = tree_dofs.iter().map(Vec::len).sum();
        let slot = |_| Island {
            dofs: Vec::with_capacity(runs),
            drives: Vec::with_capacity(runs),
            limits: Vec::with_capacity(runs),
            rows: RowSet::EMPTY,
            pairs: Vec::with_capacity(pairs),
        };
        let (joined, slots) = ((0..roots.len()).collect(), (0..roots.len()).map(slot).collect());
        Self { tree_of_body, roots, tree_dofs, tree_rows, joined, slots }
    }

    /// Forgets the couplings of the step before.
    pub fn reset(&mut self) {
        self.joined.iter_mut().enumerate().for_each(|(tree, joined)| *joined = tree);
    }

    /// Couples the trees of two bodies that move.
    pub fn join(&mut self, a: usize, b: usize) {
        let (a, b) = (self.top(self.tree_of_body[a]), self.top(self.tree_of_body[b]));
        self.joined[a.max(b)] = a.min(b);
    }

    /// Gathers the islands; `pair_bodies` has a body that moves of each pair. Drives and limits stand in the order of their
    /// degrees of freedom. Trees whose root is flagged as at rest are in none.
    pub fn gather(
        &mut self,
        pair_bodies: impl Iterator<Item = usize>,
        resting: &[bool],
        drives: &[ImplicitDrive],
        limits: &[JointLimit],
    ) {
        for slot in &mut self.slots {
            slot.dofs.clear();
            slot.drives.clear();
            slot.limits.clear();
            slot.rows = RowSet::EMPTY;
            slot.pairs.clear();
        }
        for tree in (0..self.joined.len()).filter(|&tree| !resting[self.roots[tree]]) {
            let top = self.top(tree);
            self.slots[top].dofs.extend_from_slice(&self.tree_dofs[tree]);
            self.slots[top].rows |= self.tree_rows[tree];
        }
        for (pair, body) in pair_bodies.enumerate() {
            let top = self.top(self.tree_of_body[body]);
            self.slots[top].pairs.push(pair);
        }
        for slot in &mut self.slots {
            slot.dofs.sort_unstable_by_key(|run| run.start);
            for run in &slot.dofs {
                let before = |dof: usize| drives.partition_point(|drive| drive.dof < dof);
                slot.drives.push(before(run.start)..before(run.end));
                let before = |dof: usize| limits.partition_point(|limit| limit.dof < dof);
                slot.limits.push(before(run.start)..before(run.end));
            }
        }
    }

    /// Number of slots: one for each tree, empty where another tree has taken it in.
    pub fn slots(&self) -> usize {
        self.slots.len()
    }

    /// Takes an island out of its slot, to be put back; one without degrees of freedom is part of another.
    pub fn take(&mut self, slot: usize) -> Island<W> {
        std::mem::take(&mut self.slots[slot])
    }

    pub fn put_back(&mut self, slot: usize, island: Island<W>) {
        self.slots[slot] = island;
    }

    fn top(&self, mut tree: usize) -> usize {
        while self.joined[tree] != tree {
            tree = self.joined[tree];
        }
        tree
    }
}
