//! Rankings of single subtasks. They are open to every ranked submission that played the subtask in enough rooms.
//!
//! Their order is by the lower end of the 95 % interval of strict clean success: a rate of 1 over one episode says less than one
//! of 0.98 over 64. Submissions without a success are listed and have no rank.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use fiatlux_grading::Results;
use fiatlux_rules::Task;
use serde::{Deserialize, Serialize};

use super::{Cell, Rooms, lower_bound};
use crate::{Division, Entry};

/// The results of a submission in the subtasks that it played.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct SubtaskResults {
    version: u32,
    cells: Vec<(Cell, Rooms)>,
}

impl SubtaskResults {
    /// The subtasks in results.
    pub fn of(results: &Results) -> Self {
        let cell = |task: Task| {
            let result = results.subtasks.iter().find(|found| found.id == task.short_id())?;
            let played = results.episodes.iter().filter(|row| row.task == task.short_id());
            let seeds: BTreeSet<u64> = played.map(|row| row.seed).collect();
            Some((Cell::of(task, result), Rooms::of(results, seeds.into_iter().collect())))
        };
        Self {
            version: results.conditions.benchmark_version,
            cells: Task::SUBTASKS.into_iter().filter_map(cell).collect(),
        }
    }
}

#[derive(Debug, Clone, PartialEq)]
pub(crate) struct RankedTask {
    /// 1 for the best; equal rows share a rank, and one without a success has none.
    pub rank: Option<usize>,
    pub entry: Arc<Entry>,
    pub cell: Cell,
    /// The rooms in which it played the subtask.
    pub rooms: Rooms,
}

impl RankedTask {
    /// The order of the ranking: the lower bound of the success rate, then the score s.
    fn merit(&self) -> (f64, f64) {
        (lower_bound(self.cell.strict_clean, self.cell.strict_interval), self.cell.strict)
    }
}

/// The rankings of a subtask in the latest version of the benchmark, one for each division.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct TaskTable {
    pub task: Task,
    /// Rows by division, the best first; none of them is empty.
    pub divisions: BTreeMap<Division, Vec<RankedTask>>,
}

impl TaskTable {
    /// The best row of each division that has a success.
    pub fn best(&self) -> impl Iterator<Item = (&Division, &RankedTask)> {
        let first = self.divisions.iter().filter_map(|(division, places)| Some((division, places.first()?)));
        first.filter(|(_, place)| place.rank.is_some())
    }
}

/// Rankings of all twelve subtasks, S01 first.
pub(crate) fn by_task(tried: &[(&Arc<Entry>, &SubtaskResults)]) -> Vec<TaskTable> {
    let latest = tried.iter().filter(|(entry, _)| entry.division.is_some()).map(|(_, tried)| tried.version).max();
    let table = |task: Task| {
        let mut divisions: BTreeMap<Division, Vec<RankedTask>> = BTreeMap::new();
        for (entry, tried) in tried.iter().filter(|(_, tried)| Some(tried.version) == latest) {
            let Some((cell, rooms)) = tried.cells.iter().find(|(found, _)| found.id == task.short_id()) else {
                continue;
            };
            let Some(division) = &entry.division else { continue };
            if !entry.tasks.iter().any(|ranked| ranked == task.short_id()) {
                continue;
            }
            let cell = cell.with_failures(&entry.failed_tries);
            let place = RankedTask { rank: None, entry: Arc::clone(entry), cell, rooms: rooms.clone() };
            divisions.entry(division.clone()).or_default().push(place);
        }
        divisions.values_mut().for_each(|places| rank(places));
        TaskTable { task, divisions }
    };
    Task::SUBTASKS.into_iter().map(table).collect()
}

/// Puts the best first, the earlier one of equals above.
fn rank(places: &mut [RankedTask]) {
    places.sort_by(|a, b| {
        let ((lower_a, score_a), (lower_b, score_b)) = (a.merit(), b.merit());
        let by_merit = lower_b.total_cmp(&lower_a).then(score_b.total_cmp(&score_a));
        by_merit.then_with(|| (a.entry.received, a.entry.id).cmp(&(b.entry.received, b.entry.id)))
    });
    for index in 0..places.len() {
        let before = index.checked_sub(1).map(|before| &places[before]);
        places[index].rank = match before {
            _ if places[index].cell.strict_clean <= 0.0 => None,
            Some(before) if before.merit() == places[index].merit() => before.rank,
            _ => Some(index + 1),
        };
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{entry, hosted, results};
    use super::*;

    /// Results in which S01, and no other subtask, has this strict clean rate and interval.
    fn with(rate: f64, interval: [f64; 2]) -> Results {
        only_first(results(0), rate, interval)
    }

    fn only_first(mut changed: Results, rate: f64, interval: [f64; 2]) -> Results {
        changed.subtasks.truncate(1);
        changed.episodes.retain(|row| row.task == "S01");
        changed.subtasks[0].strict_clean_success_rate = Some(rate);
        changed.subtasks[0].strict_clean_success_interval = Some(interval);
        changed
    }

    fn tables_of(all: &[Results]) -> Vec<TaskTable> {
        let tried: Vec<_> = all
            .iter()
            .zip(1..)
            .map(|(results, id)| (Arc::new(entry(id, "p", results)), SubtaskResults::of(results)))
            .collect();
        by_task(&tried.iter().map(|(entry, tried)| (entry, tried)).collect::<Vec<_>>())
    }

    /// Guards the order by the lower bound of a rate, that nobody leads without a success, and that one subtask is
    /// enough.
    #[test]
    fn a_subtask_is_ranked_by_what_its_rate_proves() {
        let all = [with(1.0, [0.21, 1.0]), with(0.98, [0.92, 1.0]), with(0.0, [0.0, 0.8]), with(1.0, [0.21, 1.0])];
        let tables = tables_of(&all);
        assert_eq!(tables.len(), 12);
        let places = tables[0].divisions.values().next().expect("a division");
        let order: Vec<_> = places.iter().map(|place| (place.rank, place.entry.id.0)).collect();
        assert_eq!(order, [(Some(1), 2), (Some(2), 1), (Some(2), 4), (None, 3)]);
        assert_eq!(tables[0].best().count(), 1);
        assert!(tables[1].divisions.is_empty() && tables[1].best().next().is_none());
    }

    /// Guards that divisions are ranked separately, and that chosen rooms are not ranked here either.
    #[test]
    fn a_subtask_has_the_rules_of_the_tables() {
        let tables = tables_of(&[with(1.0, [0.8, 1.0]), only_first(hosted(0), 0.5, [0.3, 0.7])]);
        assert_eq!(tables[0].best().map(|(_, place)| place.entry.id.0).collect::<Vec<_>>(), [2, 1]);
        let of = |observations: &str| {
            let mut results = only_first(hosted(0), 1.0, [0.8, 1.0]);
            results.conditions.observations = observations.into();
            results
        };
        let best = tables_of(&["privileged", "goal", "standard"].map(of))[0]
            .best()
            .map(|(_, place)| place.entry.id.0)
            .collect::<Vec<_>>();
        assert_eq!(best, [3, 2, 1], "apart, the fewest senses first");
        let mut chosen = with(1.0, [0.8, 1.0]);
        chosen.episodes.iter_mut().for_each(|row| row.seed += 1000);
        let mut loose = with(1.0, [0.8, 1.0]);
        loose.without_journal = vec!["run".into()];
        let mut lucky = with(1.0, [0.8, 1.0]);
        lucky.episodes.truncate(1);
        assert!(tables_of(&[chosen, loose, lucky])[0].divisions.is_empty());
    }
}
