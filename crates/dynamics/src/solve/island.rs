//! Trees that contact couples in a step. What does not touch is minimised apart: a ladder that stands still takes no part in
//! the iterations of a robot that moves.

use std::ops::Range;

use crate::model::Model;
use crate::spec::BodyId;

/// One minimisation: a set of trees.
#[derive(Debug, Clone, Default)]
pub(crate) struct Island {
    /// Runs of degrees of freedom, ascending.
    pub dofs: Vec<Range<usize>>,
    /// Indices of the solver's body pairs, ascending.
    pub pairs: Vec<usize>,
}

impl Island {
    /// Every degree of freedom, ascending.
    pub fn dofs(&self) -> impl DoubleEndedIterator<Item = usize> + Clone + '_ {
        self.dofs.iter().cloned().flatten()
    }
}

/// The islands of one step; memory stays from step to step.
#[derive(Debug, Clone)]
pub(crate) struct Islands {
    /// Tree of each body and runs of each tree's degrees of freedom.
    tree_of_body: Vec<usize>,
    tree_dofs: Vec<Vec<Range<usize>>>,
    /// For each tree one that it is coupled with, lower or itself.
    joined: Vec<usize>,
    /// One for each tree; that of a tree which another one takes in is empty.
    slots: Vec<Island>,
}

impl Islands {
    pub fn new(model: &Model, pairs: usize) -> Self {
        let roots: Vec<usize> = (1..model.bodies.len()).filter(|&body| model.bodies[body].spec.parent.0 == 0).collect();
        let tree_of = |root: BodyId| roots.iter().position(|&r| r == root.0).unwrap_or(0);
        let tree_of_body = model.bodies.iter().map(|body| tree_of(body.root)).collect::<Vec<_>>();
        let mut tree_dofs = vec![Vec::<Range<usize>>::new(); roots.len()];
        for (dof, &body) in model.dof_body.iter().enumerate() {
            let runs = &mut tree_dofs[tree_of_body[body]];
            match runs.last_mut() {
                Some(run) if run.end == dof => run.end += 1,
                _ => runs.push(dof..dof + 1),
            }
        }
        let runs = tree_dofs.iter().map(Vec::len).sum();
        let slot = |_| Island { dofs: Vec::with_capacity(runs), pairs: Vec::with_capacity(pairs) };
        let (joined, slots) = ((0..roots.len()).collect(), (0..roots.len()).map(slot).collect());
        Self { tree_of_body, tree_dofs, joined, slots }
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

    /// Gathers the islands; `pair_bodies` has a body that moves of each pair.
    pub fn gather(&mut self, pair_bodies: impl Iterator<Item = usize>) {
        for slot in &mut self.slots {
            slot.dofs.clear();
            slot.pairs.clear();
        }
        for tree in 0..self.joined.len() {
            let top = self.top(tree);
            self.slots[top].dofs.extend_from_slice(&self.tree_dofs[tree]);
        }
        for (pair, body) in pair_bodies.enumerate() {
            let top = self.top(self.tree_of_body[body]);
            self.slots[top].pairs.push(pair);
        }
        for slot in &mut self.slots {
            slot.dofs.sort_unstable_by_key(|run| run.start);
        }
    }

    /// Number of slots.
    pub fn slots(&self) -> usize {
        self.slots.len()
    }

    /// Takes an island out of its slot, to be put back; one without degrees of freedom is part of another.
    pub fn take(&mut self, slot: usize) -> Island {
        std::mem::take(&mut self.slots[slot])
    }

    pub fn put_back(&mut self, slot: usize, island: Island) {
        self.slots[slot] = island;
    }

    fn top(&self, mut tree: usize) -> usize {
        while self.joined[tree] != tree {
            tree = self.joined[tree];
        }
        tree
    }
}
