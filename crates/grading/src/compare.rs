//! Compares two runs, episode by episode.
//!
//! Episodes are paired by task, seed and index: the same room and the same start. Only the policies then differ within a
//! pair, so a test on the differences needs no assumption about rooms. [`sign_flip_p`] is the test, for successes and for
//! gate progress alike.

mod exact;

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use fiatlux_proto::plain;
use fiatlux_rules::Task;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use thiserror::Error;

use self::exact::sign_flip_p;
use crate::{RESULTS_VERSION, Results};

/// Largest `results.json`, bytes.
pub(crate) const MAX_RESULTS_BYTES: u64 = 256 << 20;
/// Gate progress is counted in steps of one over this number, which is exact for gates of up to ten criteria.
const PROGRESS_STEPS: f64 = 2520.0;

/// Conditions that the policy chooses; they may differ between A and B, because `observations` already limits what it
/// senses.
const OF_THE_POLICY: [&str; 2] = ["sensors", "weights"];

#[derive(Debug, Error)]
pub enum CompareError {
    #[error("cannot read {}", .file.display())]
    Read { file: PathBuf, source: std::io::Error },
    #[error("{} is not a results.json of this scorer; grade its bags again", .file.display())]
    Form { file: PathBuf, source: serde_json::Error },
    #[error(
        "{} has form {found} of results.json, and this scorer reads {RESULTS_VERSION}; grade its bags again",
        .file.display()
    )]
    Version { file: PathBuf, found: u64 },
    #[error("{field} is {a} in A and {b} in B; results compare under the same conditions, or with --any-conditions")]
    Conditions { field: String, a: String, b: String },
    #[error("{} has {task}, seed {seed}, episode {episode} twice", .file.display())]
    Twice { file: PathBuf, task: String, seed: u64, episode: u64 },
    #[error("no episode of A has the task, seed and index of one of B; play both on the same seeds")]
    NoPairs,
}

/// The part of `results.json` that a comparison reads.
#[derive(Debug, Deserialize)]
struct ComparedResults {
    policy: String,
    episodes: Vec<ComparedEpisode>,
    conditions: BTreeMap<String, Value>,
    versions: BTreeMap<String, Value>,
}

#[derive(Debug, Clone, Deserialize)]
struct ComparedEpisode {
    task: String,
    seed: u64,
    episode: u64,
    success: bool,
    gate_progress: f64,
    /// Verdict of the strict judge; `null` if the episode was played by protocol `published`.
    #[serde(default)]
    strict_success: Option<bool>,
    #[serde(default)]
    strict_progress: Option<f64>,
}

impl ComparedEpisode {
    /// Success and gate progress by the strict judge.
    fn strict(&self) -> Option<(bool, f64)> {
        self.strict_success.zip(self.strict_progress)
    }
}

impl TryFrom<&Results> for ComparedResults {
    type Error = serde_json::Error;

    fn try_from(results: &Results) -> Result<Self, serde_json::Error> {
        let fields = |value: Value| match value {
            Value::Object(fields) => fields.into_iter().collect(),
            _ => BTreeMap::new(),
        };
        let episodes = results.episodes.iter().map(|row| ComparedEpisode {
            task: row.task.clone(),
            seed: row.seed,
            episode: row.episode,
            success: row.success,
            gate_progress: row.gate_progress,
            strict_success: row.strict_success,
            strict_progress: row.strict_progress,
        });
        Ok(Self {
            policy: results.policy.clone(),
            episodes: episodes.collect(),
            conditions: fields(serde_json::to_value(&results.conditions)?),
            versions: fields(serde_json::to_value(&results.versions)?),
        })
    }
}

type EpisodeKey = (String, u64, u64);

/// Outcome of a comparison. Its JSON is the output of `scorer compare --json`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Comparison {
    /// The run named first. Differences are A minus B.
    pub a: ComparedRun,
    pub b: ComparedRun,
    /// The judge whose success and progress are compared: `strict` if every episode has them, else `published`.
    pub success: String,
    /// Fields of `conditions` that differ; empty unless differences were allowed.
    pub different_conditions: Vec<String>,
    /// One entry for each task that both played, in the order of task ids.
    pub tasks: Vec<Pairs>,
    /// All pairs of the twelve subtasks together; `null` if there is none.
    pub overall: Option<Pairs>,
}

#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ComparedRun {
    pub policy: String,
    pub file: PathBuf,
    /// Episodes that the other run does not have; they are left out.
    pub unpaired: usize,
}

/// Pairs of episodes, and tests on their differences.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Pairs {
    /// Id of the task, such as `S01`, or `all`.
    pub task: String,
    pub pairs: usize,
    pub successes_a: usize,
    pub successes_b: usize,
    pub only_a: usize,
    pub only_b: usize,
    /// Exact two-sided p-value of the sign test (McNemar) on `only_a` and `only_b`.
    pub success_p: f64,
    /// Mean gate progress of A, 0 to 1.
    pub progress_a: f64,
    /// Mean gate progress of B, 0 to 1.
    pub progress_b: f64,
    /// Exact two-sided p-value of the sign-flip test on the differences in gate progress.
    pub progress_p: f64,
    /// Score of A minus that of B over these pairs: half success rate, half gate progress. Over all tasks it is
    /// weighted like S.
    pub score_difference: f64,
}

impl Comparison {
    /// True if episodes were left out because the other run does not have them.
    pub fn has_unpaired(&self) -> bool {
        self.a.unpaired + self.b.unpaired > 0
    }

    /// The comparison as indented JSON, with a newline at the end.
    pub fn to_json(&self) -> Result<String, serde_json::Error> {
        Ok(serde_json::to_string_pretty(self)? + "\n")
    }

    /// The comparison as a table for a terminal.
    pub fn to_text(&self) -> String {
        let mut out = String::new();
        // Writing to a string cannot fail.
        let _ = writeln!(out, "A: {} ({})", plain(&self.a.policy), self.a.file.display());
        let _ = writeln!(out, "B: {} ({})", plain(&self.b.policy), self.b.file.display());
        if !self.different_conditions.is_empty() {
            let _ = writeln!(out, "DIFFERENT CONDITIONS: {}", plain(&self.different_conditions.join(", ")));
        }
        if self.has_unpaired() {
            let _ = writeln!(out, "Not paired: {} of A, {} of B", self.a.unpaired, self.b.unpaired);
        }
        let _ = writeln!(
            out,
            "\n                {:^38}  {:^28}   score",
            self.success.clone() + " successes",
            "gate progress"
        );
        let _ = writeln!(
            out,
            "{:<8}{:>6}  {:>6}{:>6}{:>8}{:>8}{:>9}   {:>8}{:>8}{:>9}{:>9}",
            "task", "pairs", "A", "B", "only A", "only B", "p", "A", "B", "p", "A - B"
        );
        for row in self.tasks.iter().chain(&self.overall) {
            let _ = writeln!(
                out,
                "{:<8}{:>6}  {:>6}{:>6}{:>8}{:>8}{:>9}   {:>8.3}{:>8.3}{:>9}{:>+9.3}",
                plain(&row.task),
                row.pairs,
                row.successes_a,
                row.successes_b,
                row.only_a,
                row.only_b,
                p_value(row.success_p),
                row.progress_a,
                row.progress_b,
                p_value(row.progress_p),
                row.score_difference
            );
        }
        out
    }
}

fn p_value(p: f64) -> String {
    if p < 1e-4 { format!("{p:.0e}") } else { format!("{p:.4}") }
}

/// Compares two results, each a file or a folder with a `results.json`.
///
/// # Errors
/// [`CompareError`]: a file that cannot be read, conditions that differ unless `any_conditions`, or no pair.
pub fn compare(a: &Path, b: &Path, any_conditions: bool) -> Result<Comparison, CompareError> {
    pair_up(read(a)?, read(b)?, any_conditions)
}

/// As [`compare`], for results in memory. Errors and [`ComparedRun::file`] use the names given here.
pub fn compare_results(
    (name_a, a): (&str, &Results),
    (name_b, b): (&str, &Results),
    any_conditions: bool,
) -> Result<Comparison, CompareError> {
    let run = |name: &str, results: &Results| match ComparedResults::try_from(results) {
        Ok(run) => Ok((PathBuf::from(name), run)),
        Err(source) => Err(CompareError::Form { file: name.into(), source }),
    };
    pair_up(run(name_a, a)?, run(name_b, b)?, any_conditions)
}

fn pair_up(
    (file_a, a): (PathBuf, ComparedResults),
    (file_b, b): (PathBuf, ComparedResults),
    any_conditions: bool,
) -> Result<Comparison, CompareError> {
    let different = different_conditions(&a, &b);
    if let Some((field, a, b)) = different.first().filter(|_| !any_conditions) {
        return Err(CompareError::Conditions { field: field.clone(), a: a.to_string(), b: b.to_string() });
    }
    let strict = a.episodes.iter().chain(&b.episodes).all(|episode| episode.strict().is_some());
    let (of_a, of_b) = (by_key(&file_a, &a)?, by_key(&file_b, &b)?);
    let mut pairs: BTreeMap<&str, Vec<Pair>> = BTreeMap::new();
    let mut paired = 0;
    for (key, a) in &of_a {
        if let Some(b) = of_b.get(key) {
            paired += 1;
            pairs.entry(&key.0).or_default().push(Pair::new(a, b, strict));
        }
    }
    if paired == 0 {
        return Err(CompareError::NoPairs);
    }
    let subtask = |name: &&str| Task::SUBTASKS.into_iter().find(|task| task.short_id() == *name);
    let scored: Vec<(f64, &Vec<Pair>)> =
        pairs.iter().filter_map(|(name, pairs)| Some((subtask(name)?.weight(), pairs))).collect();
    let all: Vec<Pair> = scored.iter().flat_map(|(_, pairs)| pairs.iter().copied()).collect();
    let weights: f64 = scored.iter().map(|(weight, _)| weight).sum();
    let difference: f64 = scored.iter().map(|(weight, pairs)| weight * score_difference(pairs)).sum();
    let overall = (!all.is_empty()).then(|| Pairs { score_difference: difference / weights, ..summary("all", &all) });
    Ok(Comparison {
        success: if strict { "strict" } else { "published" }.into(),
        different_conditions: different.into_iter().map(|(field, ..)| field).collect(),
        tasks: pairs.iter().map(|(task, pairs)| summary(task, pairs)).collect(),
        overall,
        a: ComparedRun { policy: a.policy, file: file_a, unpaired: of_a.len() - paired },
        b: ComparedRun { policy: b.policy, file: file_b, unpaired: of_b.len() - paired },
    })
}

fn read(path: &Path) -> Result<(PathBuf, ComparedResults), CompareError> {
    let file = if path.is_dir() { path.join("results.json") } else { path.to_owned() };
    let text = fiatlux_files::read(&file, MAX_RESULTS_BYTES)
        .map_err(|source| CompareError::Read { file: file.clone(), source })?;
    let mut run: ComparedResults =
        serde_json::from_slice(&text).map_err(|source| CompareError::Form { file: file.clone(), source })?;
    // Scorers before this field wrote nothing, because there was only one version.
    run.conditions.entry("action_delay_ms".into()).or_insert(0.into());
    let found = run.versions.get("results").and_then(Value::as_u64).unwrap_or_default();
    if found != u64::from(RESULTS_VERSION) {
        return Err(CompareError::Version { file, found });
    }
    Ok((file, run))
}

/// Fields of the conditions that differ, with both values, except the policy's own.
fn different_conditions(a: &ComparedResults, b: &ComparedResults) -> Vec<(String, Value, Value)> {
    let names: BTreeSet<&String> = a.conditions.keys().chain(b.conditions.keys()).collect();
    let value = |run: &ComparedResults, name: &String| run.conditions.get(name).cloned().unwrap_or_default();
    let both = names.into_iter().map(|name| (name.clone(), value(a, name), value(b, name)));
    both.filter(|(name, a, b)| a != b && !OF_THE_POLICY.contains(&name.as_str())).collect()
}

fn by_key(file: &Path, run: &ComparedResults) -> Result<BTreeMap<EpisodeKey, ComparedEpisode>, CompareError> {
    let mut found = BTreeMap::new();
    for episode in &run.episodes {
        let ComparedEpisode { task, seed, episode: index, .. } = episode.clone();
        if found.insert((task.clone(), seed, index), episode.clone()).is_some() {
            return Err(CompareError::Twice { file: file.to_owned(), task, seed, episode: index });
        }
    }
    Ok(found)
}

/// Success and gate progress of A and B in one episode, by the same judge.
#[derive(Debug, Clone, Copy)]
struct Pair {
    success: [bool; 2],
    progress: [f64; 2],
}

impl Pair {
    fn new(a: &ComparedEpisode, b: &ComparedEpisode, strict: bool) -> Self {
        let judged = |episode: &ComparedEpisode| {
            let published = (episode.success, episode.gate_progress);
            if strict { episode.strict().unwrap_or(published) } else { published }
        };
        let (a, b) = (judged(a), judged(b));
        Self { success: [a.0, b.0], progress: [a.1, b.1] }
    }
}

fn summary(task: &str, pairs: &[Pair]) -> Pairs {
    let count = |is: &dyn Fn(&Pair) -> bool| pairs.iter().filter(|pair| is(pair)).count();
    let successes: Vec<i64> = pairs.iter().map(|Pair { success: [a, b], .. }| i64::from(*a) - i64::from(*b)).collect();
    let progress = pairs.iter().map(|Pair { progress: [a, b], .. }| ((a - b) * PROGRESS_STEPS).round() as i64);
    let progress: Vec<i64> = progress.collect();
    Pairs {
        task: task.into(),
        pairs: pairs.len(),
        successes_a: count(&|pair| pair.success[0]),
        successes_b: count(&|pair| pair.success[1]),
        only_a: count(&|pair| pair.success[0] && !pair.success[1]),
        only_b: count(&|pair| pair.success[1] && !pair.success[0]),
        success_p: sign_flip_p(&successes),
        progress_a: mean(pairs, |pair| pair.progress[0]),
        progress_b: mean(pairs, |pair| pair.progress[1]),
        progress_p: sign_flip_p(&progress),
        score_difference: score_difference(pairs),
    }
}

/// Mean over the pairs; needs at least one.
fn mean(pairs: &[Pair], value: impl Fn(&Pair) -> f64) -> f64 {
    pairs.iter().map(value).sum::<f64>() / pairs.len() as f64
}

fn score_difference(pairs: &[Pair]) -> f64 {
    let score = |pair: &Pair, side: usize| 0.5 * (f64::from(u8::from(pair.success[side])) + pair.progress[side]);
    mean(pairs, |pair| score(pair, 0) - score(pair, 1))
}
