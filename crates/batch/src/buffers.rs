//! Buffers for the results of a step.

use crate::job::{Job, part};
use crate::{BatchError, Outcome, Spec};

/// Buffers of the caller, which receive the results of a step. Arrays are in the order of worlds; the numbers of a
/// world are in the order of [`Spec`](crate::Spec).
#[derive(Debug)]
pub struct Buffers<'a> {
    /// Observations; if the step ended an episode, the first observation of the next one. Pictures in them are bytes: see
    /// [`Field`](crate::Field).
    pub observation: &'a mut [f32],
    /// The last observation of each episode that ended; the parts of other worlds are left unchanged. `None` if the
    /// caller does not want them, and then they are not computed.
    pub final_observation: Option<&'a mut [f32]>,
    /// Sum of the reward's terms.
    pub reward: &'a mut [f32],
    /// Each term of the reward.
    pub reward_terms: Option<&'a mut [f32]>,
    /// The episode ended by success or failure.
    pub terminated: &'a mut [bool],
    /// The episode ended by time-out.
    pub truncated: &'a mut [bool],
    /// The episode ended by success.
    pub success: &'a mut [bool],
}

/// Buffers for one batch, for callers without buffers.
#[derive(Debug, Clone, Default)]
#[allow(missing_docs)] // As of `Buffers`.
pub struct Outputs {
    pub observation: Vec<f32>,
    pub final_observation: Vec<f32>,
    pub reward: Vec<f32>,
    pub reward_terms: Vec<f32>,
    pub terminated: Vec<bool>,
    pub truncated: Vec<bool>,
    pub success: Vec<bool>,
}

impl Outputs {
    pub(crate) fn of(spec: &Spec, worlds: usize) -> Self {
        let numbers = |each: usize| vec![0.0; worlds * each];
        let flags = || vec![false; worlds];
        Self {
            observation: numbers(spec.observation_length()),
            final_observation: numbers(spec.observation_length()),
            reward: numbers(1),
            reward_terms: numbers(spec.rewards.len()),
            terminated: flags(),
            truncated: flags(),
            success: flags(),
        }
    }

    /// All of them, for a step to write to.
    pub fn buffers(&mut self) -> Buffers<'_> {
        Buffers {
            observation: &mut self.observation,
            final_observation: Some(&mut self.final_observation),
            reward: &mut self.reward,
            reward_terms: Some(&mut self.reward_terms),
            terminated: &mut self.terminated,
            truncated: &mut self.truncated,
            success: &mut self.success,
        }
    }
}

impl Buffers<'_> {
    /// Refuses buffers that do not fit this number of worlds.
    pub(crate) fn check(&self, spec: &Spec, worlds: usize) -> Result<(), BatchError> {
        let length = worlds * spec.observation_length();
        let finals = self.final_observation.as_ref().map_or(length, |buffer| buffer.len());
        let terms = worlds * spec.rewards.len();
        for (field, found, expected) in [
            ("observation", self.observation.len(), length),
            ("final_observation", finals, length),
            ("reward", self.reward.len(), worlds),
            ("reward_terms", self.reward_terms.as_ref().map_or(terms, |buffer| buffer.len()), terms),
            ("terminated", self.terminated.len(), worlds),
            ("truncated", self.truncated.len(), worlds),
            ("success", self.success.len(), worlds),
        ] {
            check_length(field, found, expected)?;
        }
        Ok(())
    }

    /// Copies the results of a world.
    pub(crate) fn copy_from(&mut self, job: &Job) {
        let (world, outcome) = (job.world, job.outcome);
        job.copy_observation(self.observation);
        let has_ended = outcome != Outcome::Continues && !job.final_observation.is_empty();
        if let Some(buffer) = self.final_observation.as_deref_mut().filter(|_| has_ended) {
            part(buffer, world, job.final_observation.len()).copy_from_slice(&job.final_observation);
        }
        self.reward[world] = job.reward;
        if let Some(buffer) = self.reward_terms.as_deref_mut() {
            part(buffer, world, job.reward_terms.len()).copy_from_slice(&job.reward_terms);
        }
        self.terminated[world] = matches!(outcome, Outcome::Success | Outcome::Failure);
        self.truncated[world] = outcome == Outcome::TimeOut;
        self.success[world] = outcome == Outcome::Success;
    }
}

/// Refuses sizes that the system has no memory for.
pub(crate) fn check_memory(spec: &Spec, worlds: usize) -> Result<(), BatchError> {
    let numbers = spec.observation_length();
    // Twice the observation, with a byte for each other result.
    let each = spec.rewards.len() + 2 * spec.actions.len() + 2;
    let total =
        numbers.checked_mul(2).and_then(|both| both.checked_add(each)).and_then(|each| each.checked_mul(worlds));
    let fits = total.is_some_and(can_reserve::<f32>);
    if fits { Ok(()) } else { Err(BatchError::Memory { worlds, numbers }) }
}

/// The memory of a batch that is being made. Whoever runs out of it in small pieces ends the process; so it asks for more than it
/// needs, now and then, and gives it back.
#[derive(Clone, Copy)]
pub(crate) struct Memory {
    pub worlds: usize,
    pub numbers: usize,
}

impl Memory {
    /// Worlds between two questions.
    const EACH: usize = 16;
    /// Bytes that these worlds never need, besides their observations.
    const ENOUGH: usize = 16 << 20;
    /// Bytes that a later call takes for a world, such as what it drew.
    const LATER: usize = 1 << 12;

    /// True if there is memory for the worlds until the next question, and for what later calls return.
    pub fn is_left(self, world: usize) -> bool {
        let bytes = Self::ENOUGH + self.worlds * Self::LATER + Self::EACH * self.numbers * 8;
        !world.is_multiple_of(Self::EACH) || can_reserve::<u8>(bytes)
    }

    pub fn error(self) -> BatchError {
        BatchError::Memory { worlds: self.worlds, numbers: self.numbers }
    }
}

pub(crate) fn check_length(field: &'static str, found: usize, expected: usize) -> Result<(), BatchError> {
    if found == expected { Ok(()) } else { Err(BatchError::Length { field, found, expected }) }
}

/// True if the system gives this much memory at once.
fn can_reserve<T>(count: usize) -> bool {
    let mut reserved = Vec::<T>::new();
    let fits = reserved.try_reserve_exact(count).is_ok();
    // Otherwise a compiler may leave out memory that nobody uses.
    std::hint::black_box(&reserved);
    fits
}
