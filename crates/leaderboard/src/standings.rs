//! Entries and their results as tables: one for each division, in order of what strict clean success proves. No I/O.
//!
//! Which division an entry has, if any, [`crate::claims`] decides.

mod played;
mod subtasks;
mod summary;
mod word;

use std::cmp::{Ordering, Reverse};
use std::collections::BTreeMap;
use std::sync::Arc;

use fiatlux_grading::{CompareError, RateRow, Results, TaskResult, compare_results};
use fiatlux_rules::{Rate, Task};
use serde::{Deserialize, Serialize};

use crate::{Division, Entry, SubmissionId};

pub(crate) use played::PlayedEpisodes;
pub(crate) use subtasks::{RankedTask, SubtaskResults, TaskTable, by_task};
pub(crate) use summary::{LAYOUT, Summary};
use word::Word;

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Standing {
    /// Version of the benchmark: scores of different versions never share a table.
    pub version: u32,
    pub strict: Scores,
    pub published: Scores,
    /// One cell for each of the twelve subtasks, S01 first.
    pub cells: Vec<Cell>,
    pub episodes: u64,
    /// Episodes of hosted runs that were not submitted, which count as failures.
    pub failed_tries: u64,
    pub rooms: Rooms,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Rooms {
    pub seeds: Vec<u64>,
    /// A server drew them: their numbers mean nothing to a reader.
    pub hosted: bool,
}

impl Rooms {
    fn of(results: &Results, seeds: Vec<u64>) -> Self {
        Self { seeds, hosted: results.conditions.seeds == "hosted" }
    }
}

/// Clean success over all episodes, and S.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Scores {
    pub clean: f64,
    /// Wilson 95 % interval of `clean`.
    pub interval: [f64; 2],
    pub hits: u64,
    pub score: f64,
    /// Sample standard deviation of S over the seeds; `None` with one seed.
    pub std: Option<f64>,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Cell {
    #[serde(deserialize_with = "word::task_word")]
    pub id: Word,
    #[serde(deserialize_with = "word::task_word")]
    pub name: Word,
    pub episodes: u64,
    /// Score s by the strict judge, 0 to 1.
    pub strict: f64,
    pub published: f64,
    pub strict_clean: f64,
    /// Wilson 95 % interval of `strict_clean`.
    pub strict_interval: [f64; 2],
    pub published_clean: f64,
}

impl Standing {
    /// The row of results with all twelve subtasks, by the strict judge; `None` for others.
    pub fn of(results: &Results) -> Option<Self> {
        let found = |task: Task| results.subtasks.iter().find(|found| found.id == task.short_id());
        let overall = &results.overall;
        let cells: Vec<Cell> =
            Task::SUBTASKS.into_iter().filter_map(|task| Some(Cell::of(task, found(task)?))).collect();
        if cells.len() < Task::SUBTASKS.len() {
            return None;
        }
        let (strict_clean, strict_score) = (overall.strict_clean_success.as_ref()?, results.score_strict.as_ref()?);
        let scores = |rate: &RateRow, score: f64, std| Scores {
            clean: rate.rate.unwrap_or_default(),
            interval: rate.interval.unwrap_or([0.0, 1.0]),
            hits: rate.hits,
            score,
            std,
        };
        Some(Self {
            version: results.conditions.benchmark_version,
            strict: scores(strict_clean, strict_score.mean.unwrap_or_default(), strict_score.std),
            published: scores(&overall.clean_success, results.score.mean?, results.score.std),
            cells,
            episodes: overall.episodes,
            failed_tries: 0,
            rooms: Rooms::of(results, results.seeds.clone()),
        })
    }

    /// The same row, in which these episodes by subtask count as failures, too.
    pub fn with_failures(&self, failed: &BTreeMap<String, u64>) -> Self {
        let more: u64 = failed.values().sum();
        if more == 0 {
            return self.clone();
        }
        let trials = self.episodes + more;
        let share = self.episodes as f64 / trials as f64;
        let scores = |scores: &Scores| {
            let rate = Rate { hits: scores.hits, trials };
            Scores {
                clean: rate.value().unwrap_or_default(),
                interval: rate.interval().unwrap_or([0.0, 1.0]),
                hits: scores.hits,
                score: scores.score * share,
                std: None,
            }
        };
        Self {
            strict: scores(&self.strict),
            published: scores(&self.published),
            cells: self.cells.iter().map(|cell| cell.with_failures(failed)).collect(),
            failed_tries: more,
            ..self.clone()
        }
    }

    /// True without a success and a score by the strict judge, and so without a rank.
    fn is_zero(&self) -> bool {
        self.strict.hits == 0 && self.strict.score <= 0.0
    }

    /// The order of the ranking: the lower bound of the rate of strict clean success, then strict S.
    fn merit(&self) -> (f64, f64) {
        (lower_bound(self.strict.clean, self.strict.interval), self.strict.score)
    }
}

/// Lower bound of a rate, exactly 0 for a rate of 0.
fn lower_bound(rate: f64, interval: [f64; 2]) -> f64 {
    if rate > 0.0 { interval[0] } else { 0.0 }
}

impl Cell {
    fn of(task: Task, result: &TaskResult) -> Self {
        Self {
            id: task.short_id(),
            name: task.name(),
            episodes: result.episodes,
            strict: result.strict_score_mean.unwrap_or_default(),
            published: result.score_mean,
            strict_clean: result.strict_clean_success_rate.unwrap_or_default(),
            strict_interval: result.strict_clean_success_interval.unwrap_or([0.0, 1.0]),
            published_clean: result.clean_success_rate,
        }
    }

    /// The same cell, in which the episodes of this subtask count as failures, too.
    fn with_failures(&self, failed: &BTreeMap<String, u64>) -> Self {
        let Some(more) = failed.get(self.id).filter(|more| **more > 0) else { return self.clone() };
        let trials = self.episodes + more;
        let share = self.episodes as f64 / trials as f64;
        let rate = Rate { hits: (self.strict_clean * self.episodes as f64).round() as u64, trials };
        Self {
            strict: self.strict * share,
            published: self.published * share,
            strict_clean: rate.value().unwrap_or_default(),
            strict_interval: rate.interval().unwrap_or([0.0, 1.0]),
            published_clean: self.published_clean * share,
            ..self.clone()
        }
    }
}

#[derive(Debug, Clone, PartialEq)]
pub(crate) struct RankedEntry {
    /// 1 for the best; rows with equal scores share a rank, and one at zero has none.
    pub rank: Option<usize>,
    pub entry: Arc<Entry>,
    pub standing: Standing,
}

#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Table {
    pub version: u32,
    pub division: Division,
    /// Rows of the table, the best first; never empty.
    pub places: Vec<RankedEntry>,
}

impl Table {
    /// The order of tables by their first rows, the worse one first; one without a rank is below all others.
    pub fn by_leader(&self, other: &Self) -> Ordering {
        let merit = |table: &Self| table.places.first().map_or((0.0, 0.0), |place| place.standing.merit());
        let ((lower, score), (other_lower, other_score)) = (merit(self), merit(other));
        lower.total_cmp(&other_lower).then(score.total_cmp(&other_score))
    }
}

/// A version of the benchmark, the latest one first, and a division.
type Group = (Reverse<u32>, Division);

/// Tables of all divisions, those of the latest version of the benchmark first, and of these the hosted ones.
pub(crate) fn tables(ranked: Vec<(impl Into<Arc<Entry>>, Standing)>) -> Vec<Table> {
    let mut groups: BTreeMap<Group, Vec<(Arc<Entry>, Standing)>> = BTreeMap::new();
    for (entry, standing) in ranked {
        let entry: Arc<Entry> = entry.into();
        if let Some(division) = entry.division.clone() {
            groups.entry((Reverse(standing.version), division)).or_default().push((entry, standing));
        }
    }
    let table = |((version, division), mut rows): (Group, Vec<(Arc<Entry>, Standing)>)| {
        rows.sort_by(|(entry_a, a), (entry_b, b)| {
            let ((lower_a, score_a), (lower_b, score_b)) = (a.merit(), b.merit());
            let by_merit = lower_b.total_cmp(&lower_a).then(score_b.total_cmp(&score_a));
            by_merit.then(entry_a.received.cmp(&entry_b.received)).then(entry_a.id.cmp(&entry_b.id))
        });
        let mut places: Vec<RankedEntry> = Vec::with_capacity(rows.len());
        for (entry, standing) in rows {
            let rank = match places.last() {
                _ if standing.is_zero() => None,
                Some(last) if last.standing.merit() == standing.merit() => last.rank,
                _ => Some(places.len() + 1),
            };
            places.push(RankedEntry { rank, entry, standing });
        }
        Table { version: version.0, division, places }
    };
    groups.into_iter().map(table).collect()
}

/// The result of a paired test on two neighbours in a table.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Neighbours {
    /// Both played some of the same episodes.
    Tested {
        pairs: usize,
        /// Two-sided p-value of the sign test on successes.
        p: f64,
    },
    /// They cannot be compared, for this reason.
    Untested(String),
}

/// Two neighbours differ if the p-value is below this.
pub(crate) const SIGNIFICANT: f64 = 0.05;

impl Neighbours {
    pub fn of((id_a, a): (SubmissionId, &Results), (id_b, b): (SubmissionId, &Results)) -> Self {
        match compare_results((&id_a.to_string(), a), (&id_b.to_string(), b), false) {
            Ok(compared) => match compared.overall {
                Some(all) => Self::Tested { pairs: all.pairs, p: all.success_p },
                None => Self::Untested("no common subtask".into()),
            },
            Err(CompareError::NoPairs) => Self::Untested("no common room".into()),
            Err(CompareError::Conditions { field, .. }) => {
                Self::Untested(format!("{} differs", field.replace('_', " ")))
            }
            Err(_) => Self::Untested("results of different formats".into()),
        }
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use fiatlux_grading::RESULTS_VERSION;
    use serde_json::{Value, json};
    use time::OffsetDateTime;

    use super::*;
    use crate::claims::{Facts, Progress, decide};
    use crate::{Manifest, Stage};

    /// Results of all subtasks in rooms 0 to 3, each a strict success in the first `passed` subtasks.
    pub fn results(passed: usize) -> Results {
        let rate = |hits: usize| {
            let rate = Rate { hits: hits as u64, trials: 48 };
            json!({ "hits": hits, "rate": rate.value(), "interval": rate.interval() })
        };
        let tasks: Vec<Value> =
            Task::SUBTASKS.iter().enumerate().map(|(i, task)| task_result(*task, i < passed)).collect();
        let rows = Task::SUBTASKS
            .iter()
            .enumerate()
            .flat_map(|(i, task)| [0, 1, 2, 3].map(|seed| episode(task.short_id(), seed, i < passed)));
        let score = |mean: f64| json!({ "mean": mean, "std": 0.0, "per_seed": [] });
        let mean = passed as f64 / 12.0;
        let whole = json!({
            "policy": "someone", "seeds": [0, 1, 2, 3], "score": score(mean), "score_strict": score(mean), "subtasks": tasks,
            "missing": [], "episodes": rows.collect::<Vec<_>>(), "extra_tasks": [], "excluded": [], "run": null,
            "overall": {
                "episodes": 48, "clean_success": rate(4 * passed), "success": rate(4 * passed), "broken": rate(0),
                "strict_success": rate(4 * passed), "strict_clean_success": rate(4 * passed), "dropped": rate(0),
            },
            "conditions": {
                "benchmark_version": 4, "protocol": "strict", "seeds": "public", "observations": "standard",
                "time": "lockstep", "gains": "fiatlux", "robot": "g1_inspire", "noise": true, "end_on_overridden": [],
                "ranked": true, "deviations": [], "thresholds": {}, "thresholds_set": [], "published_counting": false,
                "model_digest": "", "scene_digest": "",
            },
            "versions": {
                "results": RESULTS_VERSION, "scorer": "", "server": [], "protocol": [], "random": [], "digest_layout": "",
            },
        });
        serde_json::from_value(whole).expect("results")
    }

    /// The same of a hosted run, in four rooms that a server drew.
    pub fn hosted(passed: usize) -> Results {
        let mut hosted = results(passed);
        let drawn = |seed: u64| (1 << 40) + 7 * seed;
        hosted.conditions.seeds = "hosted".into();
        hosted.seeds.iter_mut().for_each(|seed| *seed = drawn(*seed));
        hosted.episodes.iter_mut().for_each(|row| row.seed = drawn(row.seed));
        let run = json!({
            "name": "first", "folder": ".", "policy_version": "1", "policy_link": "", "servers": ["lab"], "finished": true,
            "hosted": true, "registered": 48, "played": 48, "failed": {}, "repeated": 0, "begun_again": 0, "failures": [],
            "notes": [],
        });
        hosted.run = serde_json::from_value(run).expect("a run");
        hosted
    }

    fn task_result(task: Task, passed: bool) -> Value {
        let one = f64::from(u8::from(passed));
        json!({
            "id": task.short_id(), "name": task.name(), "weight": task.weight(), "score_mean": one, "score_std": 0.0,
            "success_rate": one, "clean_success_rate": one, "gate_progress": one, "broken_rate": 0.0, "dropped_rate": 0.0,
            "peak_hand_force_n": 0.0, "control_effort": 0.0, "mean_steps": 10.0, "episodes": 4, "episode_score": one,
            "success_interval": [0.0, 1.0], "clean_success_interval": [0.0, 1.0], "broken_interval": [0.0, 1.0],
            "dropped_interval": [0.0, 1.0], "ends": {}, "strict_score_mean": one, "strict_score_std": 0.0,
            "strict_success_rate": one, "strict_clean_success_rate": one, "strict_progress": one,
            "strict_success_interval": [0.0, 1.0], "strict_clean_success_interval": [0.0, 1.0],
        })
    }

    fn episode(task: &str, seed: u64, passed: bool) -> Value {
        let one = f64::from(u8::from(passed));
        json!({
            "task": task, "seed": seed, "episode": 0, "success": passed, "clean": passed, "broken": false, "dropped": false,
            "gate_progress": one, "peak_hand_force_n": 0.0, "control_effort": 0.0, "steps": 10, "end": "fall",
            "state_digest": "", "bag": "", "failure": null, "causes": [], "strict_success": passed, "strict_clean": passed,
            "strict_progress": one, "strict_end": "fall", "strict_steps": 10, "steps_in_gate": 0, "notes": [],
            "signed_by": null,
        })
    }

    /// A verified entry with this id; a larger id was received later.
    pub fn entry(id: u64, policy: &str, results: &Results) -> Entry {
        let facts = Facts::of(results, results.conditions.seeds == "hosted");
        let progress = Progress { episodes: 48, equal: 48, refused: 0 };
        let decided = decide(&facts, Stage::Verified, "", progress, None);
        Entry {
            id: SubmissionId(id),
            manifest: Manifest { policy: policy.into(), ..Manifest::default() },
            account: "lab".into(),
            division: decided.division,
            badge: decided.badge,
            claims: decided.claims,
            senses: facts.senses(),
            obstacle: decided.obstacle,
            tasks: facts.tasks,
            failed_tries: BTreeMap::new(),
            state: Stage::Verified,
            reason: String::new(),
            received: OffsetDateTime::UNIX_EPOCH + time::Duration::seconds(id as i64),
            progress: (48, 48),
        }
    }

    fn placed(id: u64, results: &Results) -> (Entry, Standing) {
        (entry(id, &format!("p{id}"), results), Standing::of(results).expect("a row"))
    }

    fn order(table: &Table) -> Vec<(usize, u64)> {
        table.places.iter().map(|place| (place.rank.unwrap_or_default(), place.entry.id.0)).collect()
    }

    /// Guards the order: strict clean success, then strict S; equal rows share a rank, the earlier one above. Nobody
    /// without a success is first.
    #[test]
    fn the_best_is_first() {
        let mut better_s = results(4);
        better_s.score_strict.as_mut().expect("a score").mean = Some(0.9);
        let rows = vec![placed(1, &results(4)), placed(2, &results(9)), placed(3, &results(4)), placed(4, &better_s)];
        let tables_of = tables(rows);
        assert_eq!(tables_of.len(), 1);
        assert_eq!(order(&tables_of[0]), [(1, 2), (2, 4), (3, 1), (3, 3)]);
        assert_eq!(order(&tables(vec![placed(1, &results(0)), placed(2, &results(1))])[0]), [(1, 2), (0, 1)]);
    }

    /// Guards that few episodes without a failure do not lead many with one.
    #[test]
    fn what_a_rate_proves_counts() {
        let with = |hits: u64, trials: u64| {
            let mut changed = results(12);
            let rate = Rate { hits, trials };
            changed.overall.strict_clean_success =
                Some(RateRow { hits, rate: rate.value(), interval: rate.interval() });
            changed
        };
        assert_eq!(order(&tables(vec![placed(1, &with(12, 12)), placed(2, &with(47, 48))])[0]), [(1, 2), (2, 1)]);
    }

    /// Guards that what is claimed divides nobody, and that what is proven does.
    #[test]
    fn only_proven_conditions_stand_apart() {
        let change = |results: &Results, change: &dyn Fn(&mut Results)| {
            let mut changed = results.clone();
            change(&mut changed);
            changed
        };
        let (replayed, hosted) = (results(4), hosted(4));
        let real_time = |r: &mut Results| r.conditions.time = "real time".into();
        let privileged = |r: &mut Results| r.conditions.observations = "privileged".into();
        let goal = |r: &mut Results| r.conditions.observations = "goal".into();
        let count = |results: &Results| {
            [&real_time as &dyn Fn(&mut Results), &privileged, &goal].map(|label| {
                let other = change(results, label);
                tables(vec![placed(1, results), placed(2, &other)]).len()
            })
        };
        assert_eq!(count(&replayed), [1, 1, 1]);
        assert_eq!(count(&hosted), [2, 2, 2]);
        let object = change(&replayed, &|r| {
            r.conditions.assets = vec!["crate abc".into()];
            r.conditions.deviations = vec![format!("{}crate abc", fiatlux_grading::OBJECTS)];
        });
        let old = change(&replayed, &|r| r.conditions.benchmark_version = 3);
        let all = tables(vec![placed(1, &replayed), placed(2, &hosted), placed(3, &object), placed(4, &old)]);
        assert_eq!(all.iter().map(|table| table.places[0].entry.id.0).collect::<Vec<_>>(), [2, 1, 3, 4]);
    }

    /// Guards the count of tries: hosted episodes that nobody submitted are failures in every figure.
    #[test]
    fn runs_that_were_not_submitted_count() {
        let best = hosted(12);
        let row = Standing::of(&best).expect("a row");
        let failed = Task::SUBTASKS.iter().map(|task| (task.short_id().to_owned(), 8)).collect();
        let counted = row.with_failures(&failed);
        assert_eq!((row.strict.clean, counted.strict.clean, counted.failed_tries), (1.0, 1.0 / 3.0, 96));
        assert!((counted.strict.score - 1.0 / 3.0).abs() < 1e-12);
        assert_eq!(Some(counted.strict.interval), Rate { hits: 48, trials: 144 }.interval());
        assert!(counted.cells.iter().all(|cell| cell.strict_clean == 1.0 / 3.0 && cell.strict_interval[0] < 0.2));
        assert_eq!(row.with_failures(&BTreeMap::new()), row);
    }

    /// Guards the test: in 20 of 48 pairs only one succeeds, so p = 2 / 2^20. Different conditions are not compared.
    #[test]
    fn neighbours_are_tested_on_what_they_share() {
        let (a, b) = (results(9), results(4));
        let ids = (SubmissionId(1), SubmissionId(2));
        let tested = Neighbours::Tested { pairs: 48, p: 2.0 / f64::from(1 << 20) };
        assert_eq!(Neighbours::of((ids.0, &a), (ids.1, &b)), tested);
        let mut hosted = b.clone();
        hosted.conditions.seeds = "hosted".into();
        assert_eq!(Neighbours::of((ids.0, &a), (ids.1, &hosted)), Neighbours::Untested("seeds differs".into()));
        let mut elsewhere = b;
        for row in &mut elsewhere.episodes {
            row.seed += 100;
        }
        assert_eq!(Neighbours::of((ids.0, &a), (ids.1, &elsewhere)), Neighbours::Untested("no common room".into()));
    }
}
