use std::ops::Range;

use super::steps::Step;

#[derive(Debug)]
pub(crate) struct Network {
    /// In order: each reads what the input or earlier steps wrote.
    pub(super) steps: Vec<Step>,
    /// The arena before a run: space for the input first, and the constants that steps read.
    pub(super) arena: Vec<f32>,
    pub(super) output: Range<usize>,
}

impl Network {
    /// Memory for the runs of one caller.
    pub fn arena(&self) -> Vec<f32> {
        self.arena.clone()
    }

    /// Runs once in memory from [`Self::arena`], and returns the output.
    pub fn run<'a>(&self, input: &[f32], arena: &'a mut [f32]) -> &'a [f32] {
        arena[..input.len()].copy_from_slice(input);
        self.steps.iter().for_each(|step| step.run(arena));
        &arena[self.output.clone()]
    }
}
