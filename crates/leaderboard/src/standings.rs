//! Entries and their results as tables: one for each division, in order of strict clean success. No I/O.
//!
//! A place in a table requires all twelve subtasks in the same rooms: a success rate over chosen tasks, or over more
//! episodes of the easy ones, could not be compared with any other.

mod played;
mod subtasks;

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet};

use fiatlux_grading::{CompareError, RateRow, Results, TaskResult, compare_results};
use fiatlux_rules::{SeedOwner, Task};

use crate::{Badge, Division, Entry, SubmissionId};

pub(crate) use played::PlayedEpisodes;
pub(crate) use subtasks::{RankedTask, SubtaskResults, TaskTable, by_task};

#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Standing {
    /// Version of the benchmark: scores of different versions never share a table.
    pub version: u32,
    pub strict: Scores,
    pub published: Scores,
    /// One cell for each of the twelve subtasks, S01 first.
    pub cells: Vec<Cell>,
    pub episodes: u64,
    pub rooms: Rooms,
}

#[derive(Debug, Clone, PartialEq, Eq)]
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
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Scores {
    pub clean: f64,
    /// Wilson 95 % interval of `clean`.
    pub interval: [f64; 2],
    pub hits: u64,
    pub score: f64,
    /// Sample standard deviation of S over the seeds; `None` with one seed.
    pub std: Option<f64>,
}

#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Cell {
    pub id: &'static str,
    pub name: &'static str,
    pub episodes: u64,
    /// Score s by the strict judge, 0 to 1.
    pub strict: f64,
    pub published: f64,
    pub strict_clean: f64,
    /// Wilson 95 % interval of `strict_clean`.
    pub strict_interval: [f64; 2],
    pub published_clean: f64,
}

/// The reason why a submission has no place in a table, as text for the page.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Obstacle(pub String);

impl Standing {
    /// The row of a submission with this badge, or the reason why its results have no place in a table.
    pub fn of(results: &Results, badge: Badge) -> Result<Self, Obstacle> {
        let found = |task: Task| results.subtasks.iter().find(|found| found.id == task.short_id());
        let lacking: Vec<_> = Task::SUBTASKS.into_iter().filter(|task| found(*task).is_none()).collect();
        if !lacking.is_empty() {
            let names: Vec<_> = lacking.iter().map(|task| task.short_id()).collect();
            return Err(Obstacle(format!("no episode of {}", names.join(", "))));
        }
        if Division::of(results).is_none() {
            return Err(Obstacle(Division::obstacle(results)));
        }
        same_rooms(results)?;
        is_fair(results, badge)?;
        let overall = &results.overall;
        let strict = overall.strict_clean_success.as_ref().zip(results.score_strict.as_ref());
        let (Some((strict_clean, strict_score)), Some(published)) = (strict, results.score.mean) else {
            return Err(Obstacle("no strict score".into()));
        };
        let scores = |rate: &RateRow, score: f64, std| Scores {
            clean: rate.rate.unwrap_or_default(),
            interval: rate.interval.unwrap_or([0.0, 1.0]),
            hits: rate.hits,
            score,
            std,
        };
        Ok(Self {
            version: results.conditions.benchmark_version,
            strict: scores(strict_clean, strict_score.mean.unwrap_or_default(), strict_score.std),
            published: scores(&overall.clean_success, published, results.score.std),
            cells: Task::SUBTASKS.into_iter().filter_map(|task| Some(Cell::of(task, found(task)?))).collect(),
            episodes: overall.episodes,
            rooms: Rooms::of(results, results.seeds.clone()),
        })
    }

    /// True without a success and a score by the strict judge, and so without a rank.
    fn is_zero(&self) -> bool {
        self.strict.hits == 0 && self.strict.score <= 0.0
    }
}

/// Checks that no episode may have been left out, and that nobody could train in the rooms.
fn is_fair(results: &Results, badge: Badge) -> Result<(), Obstacle> {
    if !results.without_journal.is_empty() {
        return Err(Obstacle("its journal is missing: episodes may have been left out".into()));
    }
    // Seeds that servers draw are far above these, and nobody could train in their rooms.
    if badge != Badge::Hosted && results.seeds.iter().any(|seed| SeedOwner::of(*seed) == SeedOwner::Training) {
        let first = SeedOwner::Training.seeds();
        return Err(Obstacle(match results.conditions.seeds.as_str() {
            "hosted" => "its hosted rooms are not signed by a server of this site".into(),
            _ => format!("seeds from {} on are for training", first.start()),
        }));
    }
    Ok(())
}

/// Checks that every subtask has the same seeds and indices.
fn same_rooms(results: &Results) -> Result<(), Obstacle> {
    let mut rooms: BTreeMap<&str, BTreeSet<(u64, u64)>> = BTreeMap::new();
    for row in results.episodes.iter().filter(|row| Task::SUBTASKS.iter().any(|task| task.short_id() == row.task)) {
        rooms.entry(&row.task).or_default().insert((row.seed, row.episode));
    }
    let mut all = rooms.iter();
    let Some((first, expected)) = all.next() else { return Err(Obstacle("no episodes".into())) };
    match all.find(|(_, found)| *found != expected) {
        Some((other, _)) => Err(Obstacle(format!(
            "{first} and {other} were not played in the same rooms; play all subtasks in all seeds"
        ))),
        None => Ok(()),
    }
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
}

#[derive(Debug, Clone, PartialEq)]
pub(crate) struct RankedEntry {
    /// 1 for the best; rows with equal scores share a rank, and one at zero has none.
    pub rank: Option<usize>,
    pub entry: Entry,
    pub standing: Standing,
}

#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Table {
    pub version: u32,
    pub division: Division,
    /// Rows of the table, the best first; never empty.
    pub places: Vec<RankedEntry>,
}

/// A version of the benchmark, the latest one first, and a division.
type Group = (Reverse<u32>, Division);

/// Tables of all divisions, those of the latest version of the benchmark first.
pub(crate) fn tables(ranked: Vec<(Entry, Standing)>) -> Vec<Table> {
    let mut groups: BTreeMap<Group, Vec<(Entry, Standing)>> = BTreeMap::new();
    for (entry, standing) in ranked {
        if let Some(division) = entry.division.clone() {
            groups.entry((Reverse(standing.version), division)).or_default().push((entry, standing));
        }
    }
    let table = |((version, division), mut rows): (Group, Vec<(Entry, Standing)>)| {
        rows.sort_by(|(entry_a, a), (entry_b, b)| {
            let by_score = b.strict.clean.total_cmp(&a.strict.clean).then(b.strict.score.total_cmp(&a.strict.score));
            by_score.then(entry_a.received.cmp(&entry_b.received)).then(entry_a.id.cmp(&entry_b.id))
        });
        let mut places: Vec<RankedEntry> = Vec::with_capacity(rows.len());
        for (entry, standing) in rows {
            let rank = match places.last() {
                _ if standing.is_zero() => None,
                Some(last) if is_equal(&last.standing, &standing) => last.rank,
                _ => Some(places.len() + 1),
            };
            places.push(RankedEntry { rank, entry, standing });
        }
        Table { version: version.0, division, places }
    };
    groups.into_iter().map(table).collect()
}

fn is_equal(a: &Standing, b: &Standing) -> bool {
    (a.strict.clean, a.strict.score) == (b.strict.clean, b.strict.score)
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
    use fiatlux_grading::{OBJECTS, RESULTS_VERSION};
    use serde_json::{Value, json};
    use time::OffsetDateTime;

    use super::*;
    use crate::{Manifest, Stage};

    /// Results of all subtasks in seeds 64 and 65, each a strict success in the first `passed` subtasks.
    pub fn results(passed: usize) -> Results {
        let rate = |hits: usize| json!({ "hits": hits, "rate": hits as f64 / 24.0, "interval": [0.1, 0.9] });
        let tasks: Vec<Value> =
            Task::SUBTASKS.iter().enumerate().map(|(i, task)| task_result(*task, i < passed)).collect();
        let rows = Task::SUBTASKS
            .iter()
            .enumerate()
            .flat_map(|(i, task)| [64, 65].map(|seed| episode(task.short_id(), seed, i < passed)));
        let score = |mean: f64| json!({ "mean": mean, "std": 0.0, "per_seed": [] });
        let mean = passed as f64 / 12.0;
        let whole = json!({
            "policy": "someone", "seeds": [64, 65], "score": score(mean), "score_strict": score(mean), "subtasks": tasks,
            "missing": [], "episodes": rows.collect::<Vec<_>>(), "extra_tasks": [], "excluded": [], "run": null,
            "overall": {
                "episodes": 24, "clean_success": rate(2 * passed), "success": rate(2 * passed), "broken": rate(0),
                "strict_success": rate(2 * passed), "strict_clean_success": rate(2 * passed), "dropped": rate(0),
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

    fn task_result(task: Task, passed: bool) -> Value {
        let one = f64::from(u8::from(passed));
        json!({
            "id": task.short_id(), "name": task.name(), "weight": task.weight(), "score_mean": one, "score_std": 0.0,
            "success_rate": one, "clean_success_rate": one, "gate_progress": one, "broken_rate": 0.0, "dropped_rate": 0.0,
            "peak_hand_force_n": 0.0, "control_effort": 0.0, "mean_steps": 10.0, "episodes": 2, "episode_score": one,
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

    /// An entry with this id; a larger id was received later.
    pub fn entry(id: u64, policy: &str, results: &Results) -> Entry {
        Entry {
            id: SubmissionId(id),
            manifest: Manifest { policy: policy.into(), ..Manifest::default() },
            account: "lab".into(),
            division: Division::of(results),
            badge: Badge::Replayed,
            state: Stage::Verified,
            reason: String::new(),
            received: OffsetDateTime::UNIX_EPOCH + time::Duration::seconds(id as i64),
            progress: (24, 24),
        }
    }

    fn placed(id: u64, results: &Results) -> (Entry, Standing) {
        (entry(id, &format!("p{id}"), results), Standing::of(results, Badge::Replayed).expect("a place"))
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

    #[test]
    fn divisions_and_versions_stand_apart() {
        let change = |change: &dyn Fn(&mut Results)| {
            let mut changed = results(4);
            change(&mut changed);
            changed
        };
        let all = [
            results(4),
            change(&|r| r.conditions.time = "real time".into()),
            change(&|r| r.conditions.observations = "privileged".into()),
            change(&|r| {
                r.conditions.assets = vec!["crate abc".into()];
                r.conditions.deviations = vec![format!("{OBJECTS}crate abc")];
            }),
            change(&|r| r.conditions.benchmark_version = 3),
        ];
        let tables = tables(all.iter().zip(1..).map(|(results, id)| placed(id, results)).collect());
        assert_eq!(tables.iter().map(|table| table.places.len()).collect::<Vec<_>>(), [1; 5]);
        assert_eq!(tables.last().map(|table| table.version), Some(3));
    }

    /// Guards that a rate over chosen tasks or rooms is not ranked: it would be above an honest one.
    #[test]
    fn chosen_tasks_and_rooms_have_no_place() {
        let refused = |change: &dyn Fn(&mut Results)| {
            let mut changed = results(4);
            change(&mut changed);
            Standing::of(&changed, Badge::Replayed).expect_err("no place").0
        };
        assert!(refused(&|r| r.subtasks.truncate(11)).contains("S12"));
        let without = |r: &mut Results| r.episodes.retain(|row| (row.task.as_str(), row.seed) != ("S09", 65));
        assert!(refused(&without).contains("S01 and S09 were not played in the same rooms"));
        assert!(refused(&|r| r.conditions.deviations.push("actions are delayed by 20 ms".into())).contains("delayed"));
        assert!(refused(&|r| r.conditions.protocol = "published".into()).contains("strict"));
    }

    /// Guards that bags of a run need its journal: without it, bad episodes may be left out.
    #[test]
    fn bags_of_a_run_need_its_journal() {
        let mut loose = results(4);
        loose.without_journal = vec!["first".into()];
        let refused = Standing::of(&loose, Badge::Replayed).expect_err("no place");
        assert_eq!(refused.0, "its journal is missing: episodes may have been left out");
    }

    /// Guards that rooms for training, from seed 1000 on, are not ranked, except those that a trusted server drew.
    #[test]
    fn rooms_for_training_have_no_place() {
        let with_seed = |seed: u64, badge| {
            let mut changed = results(4);
            changed.seeds = vec![64, seed];
            changed.episodes.iter_mut().filter(|row| row.seed == 65).for_each(|row| row.seed = seed);
            Standing::of(&changed, badge).map(drop).map_err(|obstacle| obstacle.0)
        };
        assert_eq!(with_seed(999, Badge::SelfReported), Ok(()));
        for badge in [Badge::SelfReported, Badge::Replayed] {
            for seed in [1000, 1 << 32] {
                assert_eq!(with_seed(seed, badge), Err("seeds from 1000 on are for training".into()));
            }
        }
        assert_eq!(with_seed(1 << 32, Badge::Hosted), Ok(()));
    }

    /// Guards the test: in 10 of 24 pairs only one succeeds, so p = 2 / 2^10. Different conditions are not compared.
    #[test]
    fn neighbours_are_tested_on_what_they_share() {
        let (a, b) = (results(9), results(4));
        let ids = (SubmissionId(1), SubmissionId(2));
        assert_eq!(Neighbours::of((ids.0, &a), (ids.1, &b)), Neighbours::Tested { pairs: 24, p: 2.0 / 1024.0 });
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
