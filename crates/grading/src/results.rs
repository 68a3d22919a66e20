//! The results as data: the content of `results.json`.
//!
//! `RESULTS.md` lists the fields. Nothing here depends on when or where the grading ran.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::{Conditions, Series};

/// Version of the form of `results.json`. A new field does not change it; renaming or removing one does.
pub const RESULTS_VERSION: u32 = 3;

/// Results of one policy, from loose bags or from a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Results {
    /// Name of the policy, as its bags or its run give it.
    pub policy: String,
    /// Layout seeds of the scored episodes, ascending.
    pub seeds: Vec<u64>,
    /// The benchmark score S, by the published gates.
    pub score: Score,
    /// The same by the strict gates, which rankings go by; `null` where the episodes were played by protocol `published`.
    pub score_strict: Option<Score>,
    /// The subtasks that ran, in order.
    pub subtasks: Vec<TaskResult>,
    /// Subtasks that did not run under at least one of the seeds; they do not enter the score. In a run: subtasks that
    /// were not registered; they score 0.
    pub missing: Vec<String>,
    /// Scored episodes, by task, seed and index.
    pub episodes: Vec<EpisodeRow>,
    /// Totals over all subtask episodes.
    pub overall: Overall,
    /// Results of `replace` and `climb`, which have no part in S.
    pub extra_tasks: Vec<TaskResult>,
    /// Bags that are not scored, with the reason.
    pub excluded: Vec<ExcludedBag>,
    /// Conditions that all scored episodes share.
    pub conditions: Conditions,
    /// Versions of the software that made and graded the bags.
    pub versions: Versions,
    /// The run that was graded; `null` for loose bags.
    #[serde(default)]
    pub run: Option<RunResult>,
    /// Runs that loose bags belong to, sorted. Without the journals nobody can tell which of their episodes were left out.
    #[serde(default)]
    pub without_journal: Vec<String>,
}

impl Results {
    /// Whether bags that would have counted were left out, or may have been. Further copies of a scored bag and the failures
    /// of a run do not matter.
    pub fn has_data_loss(&self) -> bool {
        self.excluded.iter().any(|bag| bag.reason != Fault::Duplicate) || !self.without_journal.is_empty()
    }

    /// Says that bags of a run lack its journal, in a sentence; `None` where they do not.
    pub fn lost_journal(&self) -> Option<String> {
        let (runs, whose) = match self.without_journal.as_slice() {
            [] => return None,
            [run] => (format!("the run {run}"), "journal is missing"),
            runs => (format!("the runs {}", runs.join(", ")), "journals are missing"),
        };
        Some(format!("these bags belong to {runs}, whose {whose}: nobody can tell which episodes were left out"))
    }

    /// The text of `results.json`: indented, with a newline at the end.
    ///
    /// # Errors
    /// None in practice: every key is a string.
    pub fn to_json(&self) -> Result<String, serde_json::Error> {
        Ok(serde_json::to_string_pretty(self)? + "\n")
    }
}

/// A run: every registered episode counts.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RunResult {
    /// Name of the run, as registered.
    pub name: String,
    /// Its folder, relative to that of the results.
    pub folder: String,
    /// Version of the policy, as registered.
    pub policy_version: String,
    /// Where the policy is described, as registered.
    pub policy_link: String,
    /// Names of the servers that have a journal of it.
    pub servers: Vec<String>,
    /// Whether every journal says that no more episodes will be played.
    pub finished: bool,
    /// Whether the server drew the seeds after registration.
    pub hosted: bool,
    /// Public keys that signed the journals of the finished run, `ed25519:BASE64`; empty where one of them is not signed.
    #[serde(default)]
    pub signed_by: Vec<String>,
    /// Episodes in all.
    pub registered: u64,
    /// Number of episodes that were graded from their bags.
    pub played: u64,
    /// Number of the other episodes by the cause of their failure.
    pub failed: BTreeMap<String, u64>,
    /// Number of episodes that were begun more than once.
    pub repeated: u64,
    /// Number of those that were begun again because a server had died.
    pub begun_again: u64,
    /// Every episode that counts as a failure without rows, by index.
    pub failures: Vec<RunFailure>,
    /// Remarks for a reader, such as on an episode that two servers played.
    pub notes: Vec<String>,
}

/// An episode of a run that counts as a failure without rows.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RunFailure {
    /// Index of the episode in the run.
    pub index: u64,
    /// Id of the task, such as `S01`.
    pub task: String,
    /// Seed of the layout.
    pub seed: u64,
    /// Cause in the journal: `not run`, `abandoned`, `not repeated`, `open`; `bag lost` or `altered` where it was
    /// played.
    pub cause: String,
    /// Further details in words; may be empty.
    pub detail: String,
    /// Number of times it was begun.
    pub attempts: u32,
}

/// The scores of episodes: what [`Results`] say of them together.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Scores {
    /// The benchmark score S, by the published gates.
    pub score: Score,
    /// The same by the strict gates; `null` without strict verdicts.
    pub score_strict: Option<Score>,
    /// The subtasks that ran, in order.
    pub subtasks: Vec<TaskResult>,
    /// Subtasks that did not run under at least one of the seeds.
    pub missing: Vec<String>,
    /// Totals over all subtask episodes.
    pub overall: Overall,
    /// Results of `replace` and `climb`, which have no part in S.
    pub extra_tasks: Vec<TaskResult>,
}

/// The benchmark score over the layout seeds.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Score {
    /// Mean over the seeds, 0 to 1; `null` where no subtask ran.
    pub mean: Option<f64>,
    /// Sample standard deviation over the seeds; `null` for a single one.
    pub std: Option<f64>,
    /// Number of subtasks that S is over, of twelve: those that ran; in a run all twelve. 0 in files of older versions.
    #[serde(default)]
    pub subtasks: u64,
    /// One entry for each seed, ascending.
    pub per_seed: Vec<SeedRow>,
}

/// The benchmark score under one layout seed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SeedRow {
    /// Seed of the layout.
    pub seed: u64,
    /// Weighted mean over the subtasks that ran, 0 to 1; over all twelve in a run.
    pub score: f64,
    /// Sum of the weights of the subtasks that ran; in a run, of those that were registered.
    pub weight_covered: f64,
    /// Sum of all weights.
    pub weight_total: f64,
    /// Subtasks that did not run under this seed.
    pub missing: Vec<String>,
}

/// A task over all its episodes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TaskResult {
    /// Id of the task, such as `S01`.
    pub id: String,
    /// Title of the task, such as `Move Ladder`.
    pub name: String,
    /// Weight in S; 0 for `replace` and `climb`.
    pub weight: f64,
    /// Mean over the seeds of half the success rate plus half the mean gate progress, 0 to 1.
    pub score_mean: f64,
    /// Sample standard deviation of it over the seeds; `null` for a single one.
    pub score_std: Option<f64>,
    /// Share of episodes whose gate fired.
    pub success_rate: f64,
    /// Share of episodes whose gate fired with nothing broken and nothing dropped.
    pub clean_success_rate: f64,
    /// Mean gate progress, 0 to 1.
    pub gate_progress: f64,
    /// Share of episodes in which a bulb broke.
    pub broken_rate: f64,
    /// Share of episodes in which a bulb was dropped.
    pub dropped_rate: f64,
    /// Largest contact force of a bulb on a hand body in any episode, N.
    pub peak_hand_force_n: f64,
    /// Mean over the episodes that have rows of their [`EpisodeRow::control_effort`].
    pub control_effort: f64,
    /// Mean length in control steps of the episodes that have rows.
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
    /// Number of episodes by the cause of their end.
    pub ends: BTreeMap<String, u64>,
    /// `score_mean` by the strict gates; this field and those below are `null` without them.
    pub strict_score_mean: Option<f64>,
    /// Sample standard deviation of `strict_score_mean` over the seeds.
    pub strict_score_std: Option<f64>,
    /// Share of episodes whose strict gate fired.
    pub strict_success_rate: Option<f64>,
    /// Share of episodes whose strict gate fired with nothing broken, in the strict sense, and nothing dropped.
    pub strict_clean_success_rate: Option<f64>,
    /// Mean strict gate progress, 0 to 1.
    pub strict_progress: Option<f64>,
    /// Wilson 95 % interval of the strict success rate.
    pub strict_success_interval: Option<[f64; 2]>,
    /// Wilson 95 % interval of the strict clean success rate.
    pub strict_clean_success_interval: Option<[f64; 2]>,
}

/// A scored episode, or the failure of an episode of a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EpisodeRow {
    /// Id of the task, such as `S01`.
    pub task: String,
    /// Seed of the layout.
    pub seed: u64,
    /// Whether its gate fired.
    pub success: bool,
    /// Whether its gate fired with nothing broken and nothing dropped.
    pub clean: bool,
    /// Whether a bulb broke.
    pub broken: bool,
    /// Whether a bulb was dropped.
    pub dropped: bool,
    /// Gate progress by the published judge, 0 to 1.
    pub gate_progress: f64,
    /// Largest contact force of a bulb on a hand body, N.
    pub peak_hand_force_n: f64,
    /// Sum of squared actions, averaged over the steps.
    pub control_effort: f64,
    /// Length in control steps.
    pub steps: u64,
    /// Cause of the end, such as `success`; of a failure, see [`RunFailure::cause`].
    pub end: String,
    /// Digest of its rows, hexadecimal.
    pub state_digest: String,
    /// Path of the bag, relative to the folder of the results; empty where the episode of a run has no bag that counts.
    pub bag: String,
    /// Why an episode of a run counts as a failure without rows, see [`RunFailure::cause`]; `null` where it was graded
    /// from its rows.
    #[serde(default)]
    pub failure: Option<String>,
    /// Index of the episode; with the seed it determines start state and noise.
    pub episode: u64,
    /// All enabled end conditions that its last row met.
    pub causes: Vec<String>,
    /// Whether its strict gate fired; this field and those below up to `strict_steps` are `null` where the episode was
    /// played by protocol `published`.
    pub strict_success: Option<bool>,
    /// Whether its strict gate fired with nothing broken, in the strict sense, and nothing dropped.
    pub strict_clean: Option<bool>,
    /// Gate progress by the strict judge, 0 to 1.
    pub strict_progress: Option<f64>,
    /// Cause of the end by protocol `strict`.
    pub strict_end: Option<String>,
    /// Length by protocol `strict` in control steps: all rows of the bag.
    pub strict_steps: Option<u64>,
    /// Steps in which all criteria of the published gate held.
    pub steps_in_gate: u64,
    /// Remarks for a reader, in words.
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
    /// Number of scored subtask episodes.
    pub episodes: u64,
    /// Clean successes, the primary metric.
    pub clean_success: RateRow,
    /// Episodes whose published gate fired.
    pub success: RateRow,
    /// Episodes whose strict gate fired; `null` without strict verdicts.
    pub strict_success: Option<RateRow>,
    /// Episodes whose strict gate fired with nothing broken or dropped; `null` without strict verdicts.
    pub strict_clean_success: Option<RateRow>,
    /// Episodes in which a bulb broke.
    pub broken: RateRow,
    /// Episodes in which a bulb was dropped.
    pub dropped: RateRow,
}

/// A rate with its Wilson 95 % interval.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RateRow {
    /// Number of episodes in which it happened.
    pub hits: u64,
    /// `hits` over the number of episodes; `null` without episodes.
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
    /// It contradicts itself: its checksums, header, rows or result were changed.
    Altered,
    /// A further copy of an episode that is scored.
    Duplicate,
    /// A journal of the run names it, but the file is missing.
    Lost,
}

impl Fault {
    /// The word for this reason in tables and in `results.json`.
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
    /// Path of the bag, relative to the folder of the results.
    pub bag: String,
    /// Kind of fault, for programs.
    pub reason: Fault,
    /// What exactly is wrong, in words.
    pub detail: String,
    /// Id of its task; `null` where the header cannot be read.
    pub task: Option<String>,
    /// Its layout seed; `null` where the header cannot be read.
    pub seed: Option<u64>,
    /// Index of its episode; `null` where the header cannot be read.
    pub episode: Option<u64>,
    /// Number of steps that could be read.
    pub steps: u64,
    /// Gate progress over the rows that could be read.
    pub gate_progress: f64,
}

/// Versions of the software that made and graded the bags.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Versions {
    /// [`RESULTS_VERSION`] of the scorer that wrote the file.
    pub results: u32,
    /// Version of the scorer.
    pub scorer: String,
    /// Versions of the servers, each once.
    pub server: Vec<String>,
    /// Protocol versions of the sessions, each once.
    pub protocol: Vec<String>,
    /// Random generators, each once.
    pub random: Vec<String>,
    /// Layout of the rows in digests.
    pub digest_layout: String,
}
