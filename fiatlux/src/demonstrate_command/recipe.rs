//! Lists of demonstrations, by which they can be made again anywhere: room, length and digest of each.

use std::fmt::Write;
use std::path::Path;

use anyhow::{Context, bail};
use fiatlux_bag::Bag;
use fiatlux_cli::write_whole;
use fiatlux_rules::{BENCHMARK_VERSION, Task};
use fiatlux_runs::Demonstration;

/// Largest list that is read, bytes.
const MAX_LIST: u64 = 16 << 20;

/// An episode of a list.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct Entry {
    task: String,
    policy: String,
    seed: u64,
    steps: u64,
    digest: String,
}

impl Entry {
    /// Reads a line: task, policy, room, steps and digest.
    fn read(line: &str) -> Option<Self> {
        let words: Vec<&str> = line.split_whitespace().collect();
        let [task, policy, seed, steps, digest] = words[..] else { return None };
        let (seed, steps) = (seed.parse().ok()?, steps.parse().ok()?);
        let is_digest = digest.len() == 64 && digest.bytes().all(|byte| byte.is_ascii_hexdigit());
        is_digest.then(|| Self { task: task.into(), policy: policy.into(), seed, steps, digest: digest.into() })
    }
}

/// Demonstrations compared with a list.
#[derive(Debug, PartialEq, Eq)]
pub struct Compared {
    /// Those that are in the list with the same digest.
    pub equal: usize,
    /// Rooms that the list has with another digest.
    pub different: Vec<u64>,
    /// Rooms that the list lacks.
    pub unlisted: Vec<u64>,
}

/// Demonstrations as entries of a list.
///
/// # Errors
/// A bag cannot be read or has no result.
pub fn entries(task: Task, policy: &str, kept: &[Demonstration]) -> anyhow::Result<Vec<Entry>> {
    let entry = |kept: &Demonstration| {
        let bag = Bag::open(&kept.bag).with_context(|| format!("cannot read '{}'", kept.bag.display()))?;
        let end = bag.result().and_then(|result| result.end.clone());
        let end = end.with_context(|| format!("'{}' has no result", kept.bag.display()))?;
        let (task, policy) = (task.short_id().to_owned(), policy.to_owned());
        Ok(Entry { task, policy, seed: kept.seed, steps: end.steps, digest: end.digest })
    };
    kept.iter().map(entry).collect()
}

/// Reads a list.
///
/// # Errors
/// It cannot be read, is of another version of the benchmark, or has a line that is none.
pub fn read(path: &Path) -> anyhow::Result<Vec<Entry>> {
    let shown = path.display();
    let text = fiatlux_files::read_stream(path, MAX_LIST).with_context(|| format!("cannot read '{shown}'"))?;
    if text.lines().next() != Some(first_line().as_str()) {
        bail!("'{shown}' does not begin with '{}': it is no list, or one of another version", first_line());
    }
    let lines = text.lines().enumerate().filter(|(_, line)| !line.starts_with('#') && !line.trim().is_empty());
    lines
        .map(|(number, line)| {
            Entry::read(line)
                .with_context(|| format!("'{shown}', line {}: give task, policy, room, steps, digest", number + 1))
        })
        .collect()
}

/// Compares what was played with a list.
pub fn compare(played: &[Entry], list: &[Entry]) -> Compared {
    let mut compared = Compared { equal: 0, different: Vec::new(), unlisted: Vec::new() };
    for entry in played {
        let listed = list
            .iter()
            .find(|other| (&other.task, &other.policy, other.seed) == (&entry.task, &entry.policy, entry.seed));
        match listed {
            Some(listed) if listed == entry => compared.equal += 1,
            Some(_) => compared.different.push(entry.seed),
            None => compared.unlisted.push(entry.seed),
        }
    }
    compared
}

/// Writes a list with these entries in place of those of the same task and policy.
///
/// # Errors
/// The list that is there cannot be read, or the file cannot be written.
pub fn write(path: &Path, played: &[Entry]) -> anyhow::Result<()> {
    let mut all = if path.exists() { read(path)? } else { Vec::new() };
    let is_of = |entry: &Entry, other: &Entry| (&entry.task, &entry.policy) == (&other.task, &other.policy);
    all.retain(|entry| !played.iter().any(|other| is_of(entry, other)));
    all.extend_from_slice(played);
    all.sort();
    let mut text = first_line() + "\n";
    for Entry { task, policy, seed, steps, digest } in all {
        writeln!(text, "{task} {policy} {seed} {steps} {digest}")?;
    }
    write_whole(path, text).with_context(|| format!("cannot write '{}'", path.display()))
}

fn first_line() -> String {
    format!("# Demonstrations of benchmark version {BENCHMARK_VERSION}: task, policy, room, steps, digest")
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    fn entry(task: &str, seed: u64, digit: &str) -> Entry {
        Entry { task: task.into(), policy: "expert".into(), seed, steps: 7, digest: digit.repeat(64) }
    }

    #[test]
    fn a_list_keeps_other_tasks_and_names_what_differs() {
        let folder = std::env::temp_dir().join(format!("fiatlux-recipe-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let path = folder.join("list.txt");
        write(&path, &[entry("S06", 1001, "b"), entry("S06", 1000, "a")]).unwrap();
        write(&path, &[entry("S02", 1000, "c")]).unwrap();
        write(&path, &[entry("S06", 1000, "d"), entry("S06", 1002, "e")]).unwrap();
        let list = read(&path).unwrap();
        assert_eq!(list, [entry("S02", 1000, "c"), entry("S06", 1000, "d"), entry("S06", 1002, "e")]);
        let compared = compare(&[entry("S06", 1000, "a"), entry("S06", 1001, "b"), entry("S06", 1002, "e")], &list);
        assert_eq!(compared, Compared { equal: 1, different: vec![1000], unlisted: vec![1001] });
        for (line, named) in [("S06 expert 1000 7 abc", "line 2"), ("S06 expert x 7", "line 2")] {
            std::fs::write(&path, format!("{}\n{line}\n", first_line())).unwrap();
            assert!(format!("{:#}", read(&path).unwrap_err()).contains(named), "{line}");
        }
        std::fs::write(&path, "S06 expert 1000 7\n").unwrap();
        assert!(format!("{:#}", read(&path).unwrap_err()).contains("another version"));
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
