//! Roll-ups against numbers worked out by hand.

use crate::common::*;
use fiatlux_rules::{Benchmark, Episode, Rate, Summary, Task};

fn close(a: f64, b: f64) -> bool {
    (a - b).abs() < 1e-12
}

fn episode(task: Task, seed: u64, success: bool, gate_progress: f64) -> Episode {
    let summary = Summary { success, gate_progress, ..judge(task).summary() };
    Episode { seed, summary }
}

#[test]
fn episode_score_is_success_less_faults() {
    for (success, broken, dropped, score) in [
        (true, false, false, 1.0),
        (true, true, false, 0.0),
        (true, false, true, 0.0),
        (true, true, true, 0.0),
        (false, false, false, 0.0),
        (false, true, true, 0.0),
    ] {
        let summary = Summary { success, broken, dropped, ..judge(Task::S05).summary() };
        assert_eq!((summary.score(), summary.clean()), (score, score == 1.0));
    }
}

/// Seed 0: S01 (2.25) at 0.5 x 1/2 + 0.5 x 0.75 = 0.625 and S07 (1.0) at 0.25, so 1.65625 / 3.25.
/// Seed 3: S01 at 0.125 alone.
#[test]
fn benchmark() {
    let mut faulty = episode(Task::S01, 0, true, 1.0);
    faulty.summary.broken = true;
    faulty.summary.peak_hand_force_n = 60.0;
    faulty.summary.steps = 100;
    let mut other = episode(Task::S01, 0, false, 0.5);
    other.summary.dropped = true;
    other.summary.steps = 6_000;
    other.summary.control_effort = 3.0;
    let episodes = [
        episode(Task::S01, 3, false, 0.25),
        faulty,
        episode(Task::S07, 0, false, 0.5),
        other,
        episode(Task::Replace, 9, true, 1.0),
    ];
    let benchmark = Benchmark::of(&episodes);
    let seeds: Vec<_> = benchmark.per_seed.iter().map(|s| (s.seed, s.score, s.weight_covered)).collect();
    let first = 1.65625 / 3.25;
    assert_eq!(seeds, [(0, first, 3.25), (3, 0.125, 2.25)]);
    assert_eq!(benchmark.per_seed[0].missing.len(), 10);
    let score = benchmark.score.expect("two seeds");
    // Of two values, the sample standard deviation is their distance over the square root of 2.
    assert!(close(score.mean, (first + 0.125) / 2.0), "{score:?}");
    assert!(close(score.std.expect("two seeds"), (first - 0.125) / libm::sqrt(2.0)), "{score:?}");
    // S07 did not run under seed 3.
    assert_eq!(benchmark.missing, Task::SUBTASKS[1..]);

    let tasks: Vec<_> = benchmark.subtasks.iter().map(|s| s.task).collect();
    assert_eq!(tasks, [Task::S01, Task::S07, Task::Replace]);
    let ladder = &benchmark.subtasks[0];
    assert_eq!((ladder.success, ladder.clean_success), (Rate { hits: 1, trials: 3 }, Rate { hits: 0, trials: 3 }));
    assert_eq!((ladder.broken, ladder.dropped), (Rate { hits: 1, trials: 3 }, Rate { hits: 1, trials: 3 }));
    assert!(close(ladder.gate_progress, 1.75 / 3.0) && close(ladder.mean_steps, 6_100.0 / 3.0));
    assert_eq!((ladder.peak_hand_force_n, ladder.control_effort, ladder.episode_score), (60.0, 1.0, 0.0));
    assert!(close(ladder.score.mean, 0.375) && close(ladder.score.std.expect("two seeds"), 0.5 / libm::sqrt(2.0)));
    let approach = &benchmark.subtasks[1];
    assert_eq!((approach.score.mean, approach.score.std), (0.25, None));
}

#[test]
fn every_subtask_at_its_best_is_one() {
    let episodes: Vec<_> = Task::SUBTASKS.into_iter().map(|task| episode(task, 1, true, 1.0)).collect();
    let benchmark = Benchmark::of(&episodes);
    assert!(close(benchmark.score.expect("ran").mean, 1.0) && benchmark.missing.is_empty());
    assert!(close(benchmark.per_seed[0].weight_covered, 34.05));
}

#[test]
fn nothing_ran() {
    let benchmark = Benchmark::of(&[episode(Task::Climb, 0, true, 1.0)]);
    assert_eq!((benchmark.score, benchmark.per_seed.len()), (None, 0));
    assert_eq!(benchmark.missing, Task::SUBTASKS);
    assert_eq!(benchmark.subtasks.len(), 1);
}
