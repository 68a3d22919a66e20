//! Parses lists of tasks and seeds from the command line.

use std::str::FromStr;

use fiatlux_rules::Task;

/// Largest number of seeds in one range.
const MAX_SEEDS: u64 = 10_000;

/// Parses a list of tasks, such as `S01,S05,climb`, or `all` for the twelve subtasks; sorted, without duplicates.
///
/// # Errors
/// A message that names the wrong part.
pub fn parse_tasks(text: &str) -> Result<Vec<Task>, String> {
    let mut tasks = Vec::new();
    for name in text.split(',') {
        let named = match name.trim() {
            "all" => Task::SUBTASKS.to_vec(),
            name => vec![name.parse().map_err(|error| format!("{error}, or all for the twelve subtasks"))?],
        };
        tasks.extend(named);
    }
    tasks.sort();
    tasks.dedup();
    Ok(tasks)
}

/// A list of tasks as an argument, parsed by [`parse_tasks`].
#[derive(Debug, Clone)]
pub struct TaskList(pub Vec<Task>);

/// A list of seeds as an argument, parsed by [`parse_seeds`].
#[derive(Debug, Clone)]
pub struct SeedList(pub Vec<u64>);

impl FromStr for TaskList {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        parse_tasks(text).map(Self)
    }
}

impl FromStr for SeedList {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        parse_seeds(text).map(Self)
    }
}

/// Parses a single seed.
///
/// # Errors
/// A message that says what is wrong.
pub fn parse_seed(text: &str) -> Result<u64, String> {
    let text = text.trim();
    text.parse().map_err(|_| {
        let digits = text.strip_prefix('-').unwrap_or(text);
        match (!digits.is_empty() && digits.bytes().all(|byte| byte.is_ascii_digit()), digits == text) {
            (true, true) => format!("seed {text} is too large; the largest is {}", u64::MAX),
            (true, false) => format!("seed {text} is negative; seeds are whole numbers from 0 on"),
            _ => format!("'{text}' is not a seed; seeds are whole numbers from 0 on"),
        }
    })
}

/// Parses a list of seeds: numbers and ranges that include both ends, such as `0..3,7`; sorted, without duplicates.
///
/// # Errors
/// A message that names the wrong part.
pub fn parse_seeds(text: &str) -> Result<Vec<u64>, String> {
    let seed = |text: &str| {
        parse_seed(text).map_err(|error| format!("{error}; give a range such as 0..3 or a list such as 0,7"))
    };
    let mut seeds = Vec::new();
    for part in text.split(',') {
        match part.split_once("..") {
            None => seeds.push(seed(part)?),
            Some((first, last)) => {
                let (first, last) = (seed(first)?, seed(last.trim_start_matches('='))?);
                if last < first || last - first >= MAX_SEEDS {
                    return Err(format!(
                        "'{part}' is not a range of 1 to {MAX_SEEDS} seeds, from the first to the last"
                    ));
                }
                seeds.extend(first..=last);
            }
        }
    }
    seeds.sort_unstable();
    seeds.dedup();
    Ok(seeds)
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn lists_of_tasks() {
        assert_eq!(parse_tasks("all").unwrap(), Task::SUBTASKS);
        assert_eq!(parse_tasks("climb, s5,S05").unwrap(), [Task::S05, Task::Climb]);
        assert!(parse_tasks("S05,S13").unwrap_err().starts_with("there is no task 'S13'"));
    }

    #[test]
    fn lists_of_seeds() {
        assert_eq!(parse_seeds("0..3").unwrap(), [0, 1, 2, 3]);
        assert_eq!(parse_seeds("7,0..=1,7").unwrap(), [0, 1, 7]);
        for bad in ["", "x", "3..1", "0..99999999", "-1"] {
            assert!(parse_seeds(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn what_is_wrong_with_a_seed_is_said_in_words() {
        for (text, part) in [
            ("-1", "seed -1 is negative; seeds are whole numbers from 0 on"),
            ("99999999999999999999", "too large; the largest is 18446744073709551615"),
            ("1.5", "'1.5' is not a seed"),
            ("", "'' is not a seed"),
        ] {
            let error = parse_seed(text).unwrap_err();
            assert!(error.contains(part), "{error}");
        }
    }
}
