//! Parses lists of tasks and seeds from the command line.

use std::collections::BTreeSet;
use std::io;
use std::path::Path;
use std::str::FromStr;

use fiatlux_rules::{ReservedSeed, SeedOwner, Task};

/// Largest number of seeds in one range.
const MAX_SEEDS: u64 = 10_000;
/// Seeds drawn afresh lie below this one.
const FRESH_END: u64 = 1 << 32;
/// Prefix of a number of seeds to draw.
const FRESH: &str = "fresh:";
/// Largest file of drawn seeds, bytes.
const MAX_RECORD_BYTES: u64 = 1 << 20;

/// Parses a list of tasks, such as `S01,S05,climb`, or `all` for the twelve subtasks; sorted, without duplicates.
///
/// # Errors
/// A message that names the wrong part.
pub fn parse_tasks(text: &str) -> Result<Vec<Task>, String> {
    let mut tasks = Vec::new();
    for name in text.split(',') {
        let named = match name.trim() {
            "all" => Task::SUBTASKS.to_vec(),
            name => vec![name.parse().map_err(|error| {
                let hint = fiatlux_proto::did_you_mean(name, Task::ALL.map(Task::short_id));
                format!("{error}, or all for the twelve subtasks{hint}")
            })?],
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

/// A list of seeds as an argument: `fresh:64`, or what [`parse_seeds`] takes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SeedList {
    /// The seeds, sorted, without duplicates.
    pub seeds: Vec<u64>,
    /// They were drawn from the system's randomness.
    pub fresh: bool,
}

impl SeedList {
    /// Refuses rooms that were named and are kept for something else than training; those drawn afresh are nobody's.
    ///
    /// # Errors
    /// [`ReservedSeed`] for the first of them.
    pub fn check_training(&self) -> Result<(), ReservedSeed> {
        let named = self.seeds.iter().filter(|_| !self.fresh);
        named.copied().try_for_each(|seed| SeedOwner::check_training(seed).map(drop))
    }

    /// The seeds of an earlier draw of as many, if it was written to this file, so that the same command goes on; a new draw is
    /// written to it. Seeds that were given stay as they are.
    ///
    /// # Errors
    /// The file cannot be read or written, or has something else.
    pub fn recorded(mut self, file: &Path) -> io::Result<Self> {
        if !self.fresh {
            return Ok(self);
        }
        match fiatlux_files::read_text(file, MAX_RECORD_BYTES) {
            Ok(text) => {
                let wrong = || {
                    io::Error::other(format!(
                        "it has other rooms than {FRESH}{}; name another folder",
                        self.seeds.len()
                    ))
                };
                let seeds = text.lines().map(str::parse).collect::<Result<Vec<u64>, _>>().map_err(|_| wrong())?;
                let is_draw = seeds.len() == self.seeds.len() && seeds.iter().all(|seed| is_fresh(*seed));
                self.seeds = is_draw.then_some(seeds).ok_or_else(wrong)?;
            }
            Err(error) if error.kind() == io::ErrorKind::NotFound => {
                file.parent().map_or(Ok(()), std::fs::create_dir_all)?;
                let lines: String = self.seeds.iter().map(|seed| format!("{seed}\n")).collect();
                std::fs::write(file, lines)?;
            }
            Err(error) => return Err(error),
        }
        Ok(self)
    }
}

/// True for a seed that [`fresh_seeds`] may draw.
pub fn is_fresh(seed: u64) -> bool {
    SeedOwner::of(seed) == SeedOwner::Fresh && seed < FRESH_END
}

/// Draws different seeds of rooms for judging from the system's randomness; sorted.
///
/// # Errors
/// Of the system.
pub fn fresh_seeds(count: usize) -> io::Result<Vec<u64>> {
    let first = *SeedOwner::Fresh.seeds().start();
    let mut seeds = BTreeSet::new();
    while seeds.len() < count {
        let mut bytes = [0; 8];
        getrandom::fill(&mut bytes).map_err(io::Error::other)?;
        seeds.insert(first + u64::from_le_bytes(bytes) % (FRESH_END - first));
    }
    Ok(seeds.into_iter().collect())
}

impl FromStr for TaskList {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        parse_tasks(text).map(Self)
    }
}

impl FromStr for SeedList {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let Some(count) = text.strip_prefix(FRESH) else {
            return parse_seeds(text).map(|seeds| Self { seeds, fresh: false });
        };
        let count = count.parse().ok().filter(|count| (1..=MAX_SEEDS as usize).contains(count));
        let count =
            count.ok_or_else(|| format!("'{text}' draws no rooms; use {FRESH}N with N from 1 to {MAX_SEEDS}"))?;
        let seeds = fresh_seeds(count).map_err(|error| format!("cannot draw rooms: {error}"))?;
        Ok(Self { seeds, fresh: true })
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
    fn rooms_are_drawn_afresh_and_stay_drawn() {
        let draw = |text: &str| text.parse::<SeedList>();
        let [first, second] = ["fresh:64", "fresh:64"].map(|text| draw(text).unwrap());
        assert!(first.fresh && first.seeds.len() == 64 && first.seeds.iter().all(|seed| is_fresh(*seed)));
        assert!(first.seeds.is_sorted() && first.seeds != second.seeds);
        assert!(first.seeds[63] > 1 << 28, "drawn from all of them: {:?}", first.seeds);
        for bad in ["fresh:", "fresh:0", "fresh:10001", "fresh:-1", "fresh:x"] {
            assert!(draw(bad).unwrap_err().contains("draws no rooms"), "{bad}");
        }
        assert_eq!(draw("0..1").unwrap(), SeedList { seeds: vec![0, 1], fresh: false });

        let folder = std::env::temp_dir().join(format!("fiatlux-client-seeds-{}", std::process::id()));
        let file = folder.join("seeds.txt");
        assert_eq!(first.clone().recorded(&file).unwrap(), first);
        assert_eq!(second.clone().recorded(&file).unwrap(), first, "the same command goes on");
        assert!(draw("fresh:3").unwrap().recorded(&file).unwrap_err().to_string().contains("fresh:3"));
        for other in ["0\n", "x\n", ""] {
            std::fs::write(&file, other).unwrap();
            assert!(draw("fresh:1").unwrap().recorded(&file).is_err(), "{other}");
        }
        std::fs::remove_dir_all(&folder).unwrap();
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
