//! Results as tables: for a terminal, a spreadsheet and a paper.

mod csv;
mod latex;
mod text;

pub use csv::csv;
pub use latex::latex;
pub use text::{painted, text};

use fiatlux_proto::count;

use crate::{Conditions, Results, RunResult};

/// Layout seeds in short form: `0..3`, `0, 2, 7`.
pub fn seeds(seeds: &[u64]) -> String {
    let mut parts: Vec<(u64, u64)> = Vec::new();
    for &seed in seeds {
        match parts.last_mut() {
            Some((_, last)) if last.checked_add(1) == Some(seed) => *last = seed,
            _ => parts.push((seed, seed)),
        }
    }
    let part = |(first, last): (u64, u64)| match last - first {
        0 => first.to_string(),
        1 => format!("{first}, {last}"),
        _ => format!("{first}..{last}"),
    };
    parts.into_iter().map(part).collect::<Vec<_>>().join(", ")
}

/// Maximum length of a list of seeds, bytes.
const MAX_LIST: usize = 200;

/// Number and list of the layout seeds, such as `4 layout seeds (0..3)`.
pub(crate) fn seed_count(results: &Results) -> String {
    counted(&results.seeds)
}

fn counted(list: &[u64]) -> String {
    let (count, ends) = (list.len(), list.iter().min().zip(list.iter().max()));
    let list = seeds(list);
    match (count, ends) {
        (1, _) => format!("layout seed {list}"),
        // Hosted seeds are random, and have up to 16 digits.
        (n, Some((least, most))) if list.len() > MAX_LIST => format!("{n} layout seeds (from {least} to {most})"),
        (n, _) => format!("{n} layout seeds ({list})"),
    }
}

/// The four words and the deviations in one line.
pub(crate) fn conditions_line(conditions: &Conditions) -> String {
    let Conditions { benchmark_version, protocol, seeds, observations, time, .. } = conditions;
    let words = format!(
        "benchmark version {benchmark_version}, {protocol} protocol, {seeds} seeds, {observations} observations, {time}"
    );
    match conditions.ranked {
        true => words,
        false => format!("{words}; NOT RANKED: {}", conditions.deviations.join("; ")),
    }
}

/// Counts of a run in one line: `Run first: 48 episodes registered, 46 played, 2 failed (abandoned 1, not run 1)`.
pub(crate) fn run_line(run: &RunResult) -> String {
    let RunResult { name, registered, played, finished, .. } = run;
    let failed: u64 = run.failed.values().sum();
    let causes: Vec<_> = run.failed.iter().map(|(cause, count)| format!("{cause} {count}")).collect();
    let causes = if causes.is_empty() { String::new() } else { format!(" ({})", causes.join(", ")) };
    let rest = if *finished { "" } else { "; NOT FINISHED: episodes that are still to be played count as failures" };
    let registered = count(*registered, "episode");
    format!("Run {name}: {registered} registered, {played} played, {failed} failed{causes}{rest}")
}

/// The number of subtasks in S, such as `over 1 of 12 subtasks: not comparable`. In a run these are all, and those that
/// were not registered count 0.
pub(crate) fn coverage(results: &Results) -> String {
    let (counted, all) = (results.score.subtasks, fiatlux_rules::Task::SUBTASKS.len() as u64);
    let rest = match results.missing.len() {
        _ if counted < all => ": not comparable".into(),
        missing if results.run.is_some() && missing > 0 => format!(", {missing} of them not registered and 0"),
        _ => String::new(),
    };
    format!("over {counted} of {all} subtasks{rest}")
}

/// Subtasks without a scored episode, and those without one under some of the seeds, in lines. S leaves them out; in a
/// run they score 0. Empty if no subtask was scored: then there is no S.
pub(crate) fn missing(results: &Results) -> Vec<String> {
    if results.subtasks.is_empty() || results.missing.is_empty() {
        return Vec::new();
    }
    if results.run.is_some() {
        return vec![format!("Not registered, so 0 in S: {}", results.missing.join(", "))];
    }
    let rows = &results.score.per_seed;
    let lacks = |task: &String| -> Vec<u64> {
        rows.iter().filter(|row| row.missing.contains(task)).map(|row| row.seed).collect()
    };
    let (never, partly): (Vec<_>, Vec<_>) = results.missing.iter().partition(|task| lacks(task).len() == rows.len());
    let list = |tasks: &[&String]| tasks.iter().map(|task| task.as_str()).collect::<Vec<_>>().join(", ");
    let mut lines = Vec::new();
    if !never.is_empty() {
        lines.push(format!("Without a scored episode: {}", list(&never)));
    }
    for task in partly {
        lines.push(format!(
            "S leaves out {task} under these seeds, which have no scored episode of it: {}",
            seeds(&lacks(task))
        ));
    }
    lines
}

/// A force in newtons, with a useful number of digits.
pub(crate) fn force(newtons: f64) -> String {
    if newtons >= 100.0 { format!("{newtons:.0}") } else { format!("{newtons:.1}") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seeds_in_few_characters() {
        for (list, expected) in [(&[0, 1, 2, 3][..], "0..3"), (&[0, 1, 5], "0, 1, 5"), (&[7], "7"), (&[], "")] {
            assert_eq!(seeds(list), expected);
        }
        assert_eq!((counted(&[7]), counted(&[0, 1])), ("layout seed 7".into(), "2 layout seeds (0, 1)".into()));
        let hosted: Vec<u64> = (1..=64).map(|seed| seed * 100_000_000_000_003).collect();
        assert_eq!(counted(&hosted), "64 layout seeds (from 100000000000003 to 6400000000000192)");
    }
}
