//! Scores of subtasks and of the benchmark.

use std::collections::BTreeSet;

use super::{Episode, Rate, ScoredTask, Summary};

/// Mean and sample standard deviation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Spread {
    /// Arithmetic mean of the values.
    pub mean: f64,
    /// Sample standard deviation; `None` for a single value.
    pub std: Option<f64>,
}

impl Spread {
    /// Mean and deviation of these values; `None` without any.
    pub fn of(values: &[f64]) -> Option<Self> {
        let mean = mean(values)?;
        let squares: f64 = values.iter().map(|value| (value - mean) * (value - mean)).sum();
        let std = (values.len() > 1).then(|| libm::sqrt(squares / (values.len() - 1) as f64));
        Some(Self { mean, std })
    }
}

fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// All episodes of one task.
#[derive(Debug, Clone, PartialEq)]
pub struct SubtaskScore<T> {
    /// The task of these episodes.
    pub task: T,
    /// Half the success rate plus half the mean gate progress under each layout seed; then over the seeds.
    pub score: Spread,
    /// Rate of successful episodes.
    pub success: Rate,
    /// Successes with nothing broken and nothing dropped.
    pub clean_success: Rate,
    /// Episodes in which something broke.
    pub broken: Rate,
    /// Episodes in which something was dropped.
    pub dropped: Rate,
    /// Mean gate progress of the episodes.
    pub gate_progress: f64,
    /// Mean of the episode scores.
    pub episode_score: f64,
    /// Largest contact force of what is handled on a hand body in any episode, N.
    pub peak_hand_force_n: f64,
    /// Mean control effort of the episodes.
    pub control_effort: f64,
    /// Mean length of the episodes.
    pub mean_steps: f64,
}

impl<T: ScoredTask> SubtaskScore<T> {
    /// Scores a task's episodes; `None` if there are none. Episodes of other tasks are ignored.
    pub fn of(task: T, episodes: &[Episode<T>]) -> Option<Self> {
        let own: Vec<&Episode<T>> = episodes.iter().filter(|episode| episode.summary.task == task).collect();
        let seeds: BTreeSet<u64> = own.iter().map(|episode| episode.seed).collect();
        let scores: Vec<f64> = seeds.iter().filter_map(|seed| subtask_score(task, *seed, episodes)).collect();
        let rate = |is: fn(&Summary<T>) -> bool| Rate::of(own.iter().map(|episode| is(&episode.summary)));
        let mean_of = |value: fn(&Summary<T>) -> f64| {
            mean(&own.iter().map(|episode| value(&episode.summary)).collect::<Vec<_>>())
        };
        Some(Self {
            task,
            score: Spread::of(&scores)?,
            success: rate(|s| s.success),
            clean_success: rate(Summary::clean),
            broken: rate(|s| s.broken),
            dropped: rate(|s| s.dropped),
            gate_progress: mean_of(|s| s.gate_progress)?,
            episode_score: mean_of(Summary::score)?,
            peak_hand_force_n: own.iter().fold(0.0, |peak: f64, e| peak.max(e.summary.peak_hand_force_n)),
            control_effort: mean_of(|s| s.control_effort)?,
            mean_steps: mean_of(|s| s.steps as f64)?,
        })
    }
}

/// The tasks that the score is made of.
fn subtasks<T: ScoredTask>() -> impl Iterator<Item = T> {
    T::ALL.iter().copied().filter(|task| task.weight() > 0.0)
}

/// Half the success rate and half the mean gate progress of a task under one layout seed; `None` where it did not run.
fn subtask_score<T: ScoredTask>(task: T, seed: u64, episodes: &[Episode<T>]) -> Option<f64> {
    let own = episodes.iter().filter(|episode| episode.summary.task == task && episode.seed == seed);
    let values: Vec<f64> =
        own.map(|e| 0.5 * f64::from(u8::from(e.summary.success)) + 0.5 * e.summary.gate_progress).collect();
    mean(&values)
}

/// The benchmark under one layout seed.
#[derive(Debug, Clone, PartialEq)]
pub struct SeedScore<T> {
    /// Seed of the layout.
    pub seed: u64,
    /// Weighted mean over the subtasks that ran.
    pub score: f64,
    /// Sum of their weights.
    pub weight_covered: f64,
    /// Subtasks that did not run under this seed.
    pub missing: Vec<T>,
}

/// All scores of a policy.
#[derive(Debug, Clone, PartialEq)]
pub struct Benchmark<T> {
    /// Over the layout seeds; `None` where no subtask ran.
    pub score: Option<Spread>,
    /// For each layout seed, ascending.
    pub per_seed: Vec<SeedScore<T>>,
    /// Every task that ran, in order; some have no weight in the score.
    pub subtasks: Vec<SubtaskScore<T>>,
    /// Subtasks that are missing under one seed or more.
    pub missing: Vec<T>,
}

impl<T: ScoredTask> Benchmark<T> {
    /// Computes all scores. The order of the episodes only affects the last bit of sums.
    pub fn of(episodes: &[Episode<T>]) -> Self {
        let is_subtask = |episode: &&Episode<T>| episode.summary.task.weight() > 0.0;
        let seeds: BTreeSet<u64> = episodes.iter().filter(is_subtask).map(|episode| episode.seed).collect();
        let per_seed: Vec<SeedScore<T>> = seeds.into_iter().filter_map(|seed| SeedScore::of(seed, episodes)).collect();
        let is_missing = |task: &T| per_seed.is_empty() || per_seed.iter().any(|s| s.missing.contains(task));
        Self {
            score: Spread::of(&per_seed.iter().map(|seed| seed.score).collect::<Vec<_>>()),
            subtasks: T::ALL.iter().filter_map(|task| SubtaskScore::of(*task, episodes)).collect(),
            missing: subtasks().filter(is_missing).collect(),
            per_seed,
        }
    }
}

impl<T: ScoredTask> SeedScore<T> {
    /// Scores the subtasks that ran under a seed; `None` where none did.
    pub fn of(seed: u64, episodes: &[Episode<T>]) -> Option<Self> {
        let (mut weighted, mut weight_covered, mut missing) = (0.0, 0.0, Vec::new());
        for task in subtasks() {
            match subtask_score(task, seed, episodes) {
                Some(score) => {
                    weighted += task.weight() * score;
                    weight_covered += task.weight();
                }
                None => missing.push(task),
            }
        }
        (weight_covered > 0.0).then(|| Self { seed, score: weighted / weight_covered, weight_covered, missing })
    }
}
