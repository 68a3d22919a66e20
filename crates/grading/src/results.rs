//! The results as data: what `results.json` holds.
//!
//! `RESULTS.md` lists the fields. Nothing here depends on when or where the grading ran.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::{Conditions, Series};

/// Number of the form of `results.json`. Fields that are added do not change it; one that is renamed or removed does.
pub const RESULTS_VERSION: u32 = 2;

/// A policy's results.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Results {
    /// The policy's name.
    pub policy: String,
    /// Layout seeds of the scored episodes, ascending.
    pub seeds: Vec<u64>,
    /// The benchmark score S, by the published gates.
    pub score: Score,
    /// The same by the strict gates, which rankings go by; `null` where the episodes were played by protocol `published`.
    pub score_strict: Option<Score>,
    /// The subtasks that ran, in order.
    pub subtasks: Vec<TaskResult>,
    /// Subtasks that did not run under one of the seeds or more; they are outside the score. In a run: that were not
    /// registered; they score 0.
    pub missing: Vec<String>,
    /// Scored episodes, by task, seed and index.
    pub episodes: Vec<EpisodeRow>,
    /// All subtask episodes together.
    pub overall: Overall,
    /// `replace` and `climb`, which have no part in S.
    pub extra_tasks: Vec<TaskResult>,
    /// Bags that are not scored, and why.
    pub excluded: Vec<ExcludedBag>,
    /// Conditions that all scored episodes share.
    pub conditions: Conditions,
    /// What made and what graded the bags.
    pub versions: Versions,
    /// The run, where the folder of one was graded; `null` for loose bags.
    #[serde(default)]
    pub run: Option<RunResult>,
}

impl Results {
    /// Whether bags were left out that would have counted. A second copy of a scored one is no loss, nor are a run's failures.
    pub fn has_data_loss(&self) -> bool {
        self.excluded.iter().any(|bag| bag.reason != Fault::Duplicate)
    }

    /// As `results.json`: indented, with a newline at the end.
    ///
    /// # Errors
    /// None in practice: there are no keys that JSON cannot have.
    pub fn to_json(&self) -> Result<String, serde_json::Error> {
        Ok(serde_json::to_string_pretty(self)? + "\n")
    }
}

/// A run: every episode that was registered counts.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RunResult {
    /// Its name.
    pub name: String,
    /// Its folder, from that of the results.
    pub folder: String,
    /// Version of the policy, as it was registered.
    pub policy_version: String,
    /// Where the policy is described, as it was registered.
    pub policy_link: String,
    /// Servers that have a journal of it, by name.
    pub servers: Vec<String>,
    /// All of them say that no more episodes are played.
    pub finished: bool,
    /// The server drew the seeds after registration.
    pub hosted: bool,
    /// Public keys that signed the journals of the finished run, `ed25519:BASE64`; empty where one of them is not signed.
    #[serde(default)]
    pub signed_by: Vec<String>,
    /// Episodes in all.
    pub registered: u64,
    /// Those that were graded from their bags.
    pub played: u64,
    /// How many of the others failed by each cause.
    pub failed: BTreeMap<String, u64>,
    /// Episodes that were begun more than once.
    pub repeated: u64,
    /// Those among them that were begun again because a server had died.
    pub begun_again: u64,
    /// Each episode that counts as a failure without rows, by index.
    pub failures: Vec<RunFailure>,
    /// What a reader should know, such as an episode that two servers played.
    pub notes: Vec<String>,
}

/// An episode of a run that counts as a failure without rows.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RunFailure {
    /// Its index in the run.
    pub index: u64,
    /// `S01`.
    pub task: String,
    /// Seed of the layout.
    pub seed: u64,
    /// As the journal says: `not run`, `abandoned`, `not repeated`, `open`; `bag lost` or `altered` where it was played.
    pub cause: String,
    /// What more is known; may be empty.
    pub detail: String,
    /// How often it was begun.
    pub attempts: u32,
}

/// The benchmark score over the layout seeds.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Score {
    /// Mean over the seeds, 0 to 1; `null` where no subtask ran.
    pub mean: Option<f64>,
    /// Sample standard deviation over the seeds; `null` for a single one.
    pub std: Option<f64>,
    /// Each seed's.
    pub per_seed: Vec<SeedRow>,
}

/// The benchmark score under one layout seed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SeedRow {
    /// Seed of the layout.
    pub seed: u64,
    /// Weighted mean over the subtasks that ran, 0 to 1; over all twelve in a run.
    pub score: f64,
    /// Sum of the weights of the subtasks that ran, or were registered.
    pub weight_covered: f64,
    /// Sum of all weights.
    pub weight_total: f64,
    /// Subtasks that did not run under this seed.
    pub missing: Vec<String>,
}

/// A task over all its episodes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TaskResult {
    /// `S01`.
    pub id: String,
    /// `Move Ladder`.
    pub name: String,
    /// Weight in S; 0 for `replace` and `climb`.
    pub weight: f64,
    /// Mean over the seeds of half the success rate and half the mean gate progress, 0 to 1.
    pub score_mean: f64,
    /// Sample standard deviation of it over the seeds; `null` for a single one.
    pub score_std: Option<f64>,
    /// Share of episodes whose gate fired.
    pub success_rate: f64,
    /// Share of them in which also nothing was broken and nothing dropped.
    pub clean_success_rate: f64,
    /// Mean gate progress, 0 to 1.
    pub gate_progress: f64,
    /// Share of episodes in which a bulb broke.
    pub broken_rate: f64,
    /// Share of episodes in which a bulb was dropped.
    pub dropped_rate: f64,
    /// Largest force of a bulb on a hand body in any episode, N.
    pub peak_hand_force_n: f64,
    /// Mean of the mean sum of squared actions over the episodes that have rows.
    pub control_effort: f64,
    /// Mean length of the episodes that have rows, control steps.
    pub mean_steps: f64,
    /// Number of scored episodes.
    pub episodes: u64,
    /// Mean of the episode scores `max(0, success - broken - dropped)`.
    pub episode_score: f64,
    /// Wilson 95 % interval of the success rate.
    pub success_interval: [f64; 2],
    /// Wilson 95 % interval of the clean success rate.
    pub clean_success_interval: [f64; 2],
    /// Wilson 95 % interval of the broken rate.
    pub broken_interval: [f64; 2],
    /// Wilson 95 % interval of the dropped rate.
    pub dropped_interval: [f64; 2],
    /// How many episodes ended by each cause.
    pub ends: BTreeMap<String, u64>,
    /// `score_mean` by the strict gates; this and what follows is `null` without them.
    pub strict_score_mean: Option<f64>,
    /// Sample standard deviation of it over the seeds.
    pub strict_score_std: Option<f64>,
    /// Share of episodes whose strict gate fired.
    pub strict_success_rate: Option<f64>,
    /// Share of them in which also nothing was broken, in the strict sense, and nothing dropped.
    pub strict_clean_success_rate: Option<f64>,
    /// Mean strict progress, 0 to 1.
    pub strict_progress: Option<f64>,
    /// Wilson 95 % interval of the strict success rate.
    pub strict_success_interval: Option<[f64; 2]>,
    /// Wilson 95 % interval of the strict clean success rate.
    pub strict_clean_success_interval: Option<[f64; 2]>,
}

/// A scored episode.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EpisodeRow {
    /// `S01`.
    pub task: String,
    /// Seed of the layout.
    pub seed: u64,
    /// Its gate fired.
    pub success: bool,
    /// And nothing was broken or dropped.
    pub clean: bool,
    /// A bulb broke.
    pub broken: bool,
    /// A bulb was dropped.
    pub dropped: bool,
    /// 0 to 1.
    pub gate_progress: f64,
    /// Largest force of a bulb on a hand body, N.
    pub peak_hand_force_n: f64,
    /// Mean over the steps of the sum of squared actions.
    pub control_effort: f64,
    /// Length in control steps.
    pub steps: u64,
    /// The cause of its end.
    pub end: String,
    /// Digest of its rows, hexadecimal.
    pub state_digest: String,
    /// The bag, from the folder of the results; empty where the episode of a run has none that counts.
    pub bag: String,
    /// Why an episode of a run counts as a failure although it has no rows that count, see [`RunFailure::cause`]; `null`
    /// where it was graded from its rows.
    #[serde(default)]
    pub failure: Option<String>,
    /// The episode's index; with the seed it draws reset and noise.
    pub episode: u64,
    /// All conditions in force that its last row met.
    pub causes: Vec<String>,
    /// Its strict gate fired; this and what follows is `null` where the episode was played by protocol `published`.
    pub strict_success: Option<bool>,
    /// And nothing was broken, in the strict sense, or dropped.
    pub strict_clean: Option<bool>,
    /// 0 to 1.
    pub strict_progress: Option<f64>,
    /// The cause of its end by protocol `strict`.
    pub strict_end: Option<String>,
    /// Its length by protocol `strict`, control steps: all rows of the bag.
    pub strict_steps: Option<u64>,
    /// Steps in which all criteria of the published gate held.
    pub steps_in_gate: u64,
    /// What a reader should know.
    pub notes: Vec<String>,
    /// Key of the server that signed the result, `ed25519:BASE64`; `null` where it is not signed.
    #[serde(default)]
    pub signed_by: Option<String>,
    /// Its figure, for reports.
    #[serde(skip)]
    pub series: Series,
}

/// All scored subtask episodes together.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Overall {
    /// How many.
    pub episodes: u64,
    /// Clean successes, the primary metric.
    pub clean_success: RateRow,
    /// Successes.
    pub success: RateRow,
    /// Successes by the strict gates; `null` without them.
    pub strict_success: Option<RateRow>,
    /// Those among them in which nothing was broken or dropped.
    pub strict_clean_success: Option<RateRow>,
    /// Episodes in which a bulb broke.
    pub broken: RateRow,
    /// Episodes in which a bulb was dropped.
    pub dropped: RateRow,
}

/// A rate with its Wilson 95 % interval.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RateRow {
    /// Times it happened.
    pub hits: u64,
    /// Share; `null` without episodes.
    pub rate: Option<f64>,
    /// Wilson 95 % interval; `null` without episodes.
    pub interval: Option<[f64; 2]>,
}

/// Why a bag is not scored.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Fault {
    /// It cannot be read, or comes from another version.
    Unreadable,
    /// Its recording was never finished (`*.mcap.part`).
    Unfinished,
    /// It ends before the episode does, or rows are missing.
    Cut,
    /// The episode was stopped before its end.
    Aborted,
    /// It does not agree with itself: its checksums, its header, its rows or its result were changed.
    Altered,
    /// A second copy of an episode that is scored.
    Duplicate,
    /// The journal of the run names it, and it is not there.
    Lost,
}

impl Fault {
    /// One word for tables.
    pub fn name(self) -> &'static str {
        match self {
            Fault::Unreadable => "unreadable",
            Fault::Unfinished => "unfinished",
            Fault::Cut => "cut",
            Fault::Aborted => "aborted",
            Fault::Altered => "altered",
            Fault::Duplicate => "duplicate",
            Fault::Lost => "lost",
        }
    }
}

/// A bag that is listed, but not scored.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ExcludedBag {
    /// The bag, from the folder of the results.
    pub bag: String,
    /// Why.
    pub reason: Fault,
    /// Why, in words.
    pub detail: String,
    /// Its task, where it says so.
    pub task: Option<String>,
    /// Its layout seed, where it says so.
    pub seed: Option<u64>,
    /// Its episode's index, where it says so.
    pub episode: Option<u64>,
    /// Steps that are there.
    pub steps: u64,
    /// Gate progress as far as it goes.
    pub gate_progress: f64,
}

/// What made and what graded the bags.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Versions {
    /// Form of this file.
    pub results: u32,
    /// The scorer.
    pub scorer: String,
    /// The software that simulated, each version once.
    pub server: Vec<String>,
    /// Protocol of the sessions, each version once.
    pub protocol: Vec<String>,
    /// Random generator, each once.
    pub random: Vec<String>,
    /// Layout of the digests.
    pub digest_layout: String,
}
