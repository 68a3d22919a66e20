//! The results as data: the content of `results.json`.
//!
//! `RESULTS.md` lists the fields. Nothing here depends on when or where the grading ran.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::{Conditions, Series};

/// Version of the form of `results.json`. A new field does not change it; renaming or removing one does.
pub const RESULTS_VERSION: u32 = 3;

/// Results of one policy, from loose bags or from a run; `RESULTS.md` describes the fields.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Results {
    pub policy: String,
    pub seeds: Vec<u64>,
    pub score: Score,
    pub score_strict: Option<Score>,
    pub subtasks: Vec<TaskResult>,
    pub missing: Vec<String>,
    pub episodes: Vec<EpisodeRow>,
    pub overall: Overall,
    pub extra_tasks: Vec<TaskResult>,
    pub excluded: Vec<ExcludedBag>,
    pub conditions: Conditions,
    pub versions: Versions,
    #[serde(default)]
    pub run: Option<RunResult>,
    #[serde(default)]
    pub without_journal: Vec<String>,
    /// Of a relay: the subtasks of the errand, whoever played them; empty for other policies.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub parts: Vec<PartResult>,
}

/// A subtask within the errands of a relay: judged by its own gate, from the states that the subtasks before it left.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PartResult {
    pub id: String,
    pub name: String,
    /// The policy that played it.
    pub policy: String,
    /// Number of times that it was begun, and that it succeeded by the protocol of the episodes.
    pub reached: u64,
    pub successes: u64,
    pub success_rate: f64,
    pub success_interval: [f64; 2],
    /// Number of times that it ended by each cause; `left` where the policy went on to another subtask without success.
    pub ends: BTreeMap<String, u64>,
}

/// A subtask within an errand.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct PartRow {
    pub task: String,
    /// The row from which it was played.
    pub first_step: u64,
    /// Number of steps until the next subtask was begun.
    pub steps: u64,
    /// By the protocol of the episode.
    pub success: bool,
    pub end: String,
}

impl Results {
    /// True if bags that would have counted were left out, or may have been. Further copies of a scored bag and the
    /// failures of a run do not matter.
    pub fn has_data_loss(&self) -> bool {
        self.excluded.iter().any(|bag| bag.reason != Fault::Duplicate) || !self.without_journal.is_empty()
    }

    /// Names the runs whose journals are missing, as a sentence; `None` if there are none.
    pub fn lost_journal(&self) -> Option<String> {
        let (runs, whose) = match self.without_journal.as_slice() {
            [] => return None,
            [run] => (format!("the run {run}"), "journal is missing"),
            runs => (format!("the runs {}", runs.join(", ")), "journals are missing"),
        };
        Some(format!("these bags belong to {runs}, whose {whose}: nobody can tell which episodes were left out"))
    }

    /// The text of `results.json`: indented, with a newline at the end.
    pub fn to_json(&self) -> Result<String, serde_json::Error> {
        Ok(serde_json::to_string_pretty(self)? + "\n")
    }
}

/// A run: every registered episode counts.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RunResult {
    pub name: String,
    pub folder: String,
    pub policy_version: String,
    pub policy_link: String,
    pub servers: Vec<String>,
    pub finished: bool,
    pub hosted: bool,
    #[serde(default)]
    pub signed_by: Vec<String>,
    pub registered: u64,
    pub played: u64,
    pub failed: BTreeMap<String, u64>,
    pub repeated: u64,
    pub begun_again: u64,
    pub failures: Vec<RunFailure>,
    pub notes: Vec<String>,
}

/// An episode of a run that counts as a failure without rows.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RunFailure {
    pub index: u64,
    pub task: String,
    pub seed: u64,
    pub cause: String,
    pub detail: String,
    pub attempts: u32,
}

/// The scores of episodes: the part of [`Results`] that needs no bags.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Scores {
    pub score: Score,
    pub score_strict: Option<Score>,
    pub subtasks: Vec<TaskResult>,
    pub missing: Vec<String>,
    pub overall: Overall,
    pub extra_tasks: Vec<TaskResult>,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Score {
    pub mean: Option<f64>,
    pub std: Option<f64>,
    #[serde(default)]
    pub subtasks: u64,
    pub per_seed: Vec<SeedRow>,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SeedRow {
    pub seed: u64,
    pub score: f64,
    pub weight_covered: f64,
    pub weight_total: f64,
    pub missing: Vec<String>,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TaskResult {
    pub id: String,
    pub name: String,
    pub weight: f64,
    pub score_mean: f64,
    pub score_std: Option<f64>,
    pub success_rate: f64,
    pub clean_success_rate: f64,
    pub gate_progress: f64,
    pub broken_rate: f64,
    pub dropped_rate: f64,
    pub peak_hand_force_n: f64,
    pub control_effort: f64,
    pub mean_steps: f64,
    pub episodes: u64,
    pub episode_score: f64,
    pub success_interval: [f64; 2],
    pub clean_success_interval: [f64; 2],
    pub broken_interval: [f64; 2],
    pub dropped_interval: [f64; 2],
    pub ends: BTreeMap<String, u64>,
    pub strict_score_mean: Option<f64>,
    pub strict_score_std: Option<f64>,
    pub strict_success_rate: Option<f64>,
    pub strict_clean_success_rate: Option<f64>,
    pub strict_progress: Option<f64>,
    pub strict_success_interval: Option<[f64; 2]>,
    pub strict_clean_success_interval: Option<[f64; 2]>,
}

/// A scored episode, or the failure of an episode of a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EpisodeRow {
    pub task: String,
    pub seed: u64,
    pub success: bool,
    pub clean: bool,
    pub broken: bool,
    pub dropped: bool,
    pub gate_progress: f64,
    pub peak_hand_force_n: f64,
    pub control_effort: f64,
    pub steps: u64,
    pub end: String,
    pub state_digest: String,
    #[serde(default)]
    pub rows_digest: String,
    pub bag: String,
    #[serde(default)]
    pub failure: Option<String>,
    pub episode: u64,
    pub causes: Vec<String>,
    pub strict_success: Option<bool>,
    pub strict_clean: Option<bool>,
    pub strict_progress: Option<f64>,
    pub strict_end: Option<String>,
    pub strict_steps: Option<u64>,
    pub steps_in_gate: u64,
    pub notes: Vec<String>,
    #[serde(default)]
    pub signed_by: Option<String>,
    /// Of a relay: the subtasks in the order in which they were played.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub parts: Vec<PartRow>,
    #[serde(skip)]
    pub series: Series,
}

/// All scored subtask episodes together.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Overall {
    pub episodes: u64,
    pub clean_success: RateRow,
    pub success: RateRow,
    pub strict_success: Option<RateRow>,
    pub strict_clean_success: Option<RateRow>,
    pub broken: RateRow,
    pub dropped: RateRow,
}

/// A rate with its Wilson 95 % interval.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RateRow {
    pub hits: u64,
    pub rate: Option<f64>,
    pub interval: Option<[f64; 2]>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Fault {
    Unreadable,
    Unfinished,
    Cut,
    Aborted,
    Altered,
    Duplicate,
    Lost,
    /// A take among episodes of policies, or the other way round.
    Kind,
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
            Fault::Kind => "kind",
        }
    }
}

/// A bag that is listed, but not scored.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ExcludedBag {
    pub bag: String,
    pub reason: Fault,
    pub detail: String,
    pub task: Option<String>,
    pub seed: Option<u64>,
    pub episode: Option<u64>,
    pub steps: u64,
    pub gate_progress: f64,
}

/// Versions of the software that made and graded the bags.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Versions {
    pub results: u32,
    pub scorer: String,
    pub server: Vec<String>,
    pub protocol: Vec<String>,
    pub random: Vec<String>,
    pub digest_layout: String,
}
