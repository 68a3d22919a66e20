//! Entries that are ranked in some subtasks and not among all twelve.

use std::collections::BTreeMap;
use std::sync::Arc;

use fiatlux_rules::{Rate, Task};

use super::state::Board;
use crate::standings::RankedTask;
use crate::{Division, Entry, SubmissionId};

/// The row of an entry, with a cell for each of the twelve subtasks.
pub(super) struct PartialRow<'a> {
    pub entry: &'a Arc<Entry>,
    pub division: &'a Division,
    /// `None` where it is not ranked.
    pub cells: [Option<Place<'a>>; Task::SUBTASKS.len()],
    /// Strict clean successes in the subtasks in which it is ranked. Episodes that were not submitted are among the trials.
    pub rate: Rate,
    pub has_partners: bool,
}

/// The place of an entry in a subtask.
#[derive(Clone, Copy)]
pub(super) struct Place<'a> {
    pub ranked: &'a RankedTask,
    /// Number of rows of the ranking.
    pub of: usize,
}

impl PartialRow<'_> {
    pub fn tasks(&self) -> usize {
        self.cells.iter().flatten().count()
    }

    pub fn share(&self) -> f64 {
        self.rate.value().unwrap_or_default()
    }

    pub fn interval(&self) -> [f64; 2] {
        self.rate.interval().unwrap_or([0.0, 1.0])
    }
}

/// The entries without a row in a table of all twelve, by division; in it those with more subtasks first, then those with more successes.
/// Rankings of subtasks are of the latest version of the benchmark alone.
pub(super) fn partial_rows(board: &Board) -> Vec<PartialRow<'_>> {
    let mut rows: BTreeMap<SubmissionId, PartialRow<'_>> = BTreeMap::new();
    for (index, table) in board.tasks.iter().enumerate() {
        for (division, places) in &table.divisions {
            for ranked in places.iter().filter(|place| !place.entry.obstacle.is_empty()) {
                let row = rows.entry(ranked.entry.id).or_insert_with(|| PartialRow {
                    entry: &ranked.entry,
                    division,
                    cells: [None; Task::SUBTASKS.len()],
                    rate: Rate::default(),
                    has_partners: board.sharing.contains(&ranked.entry.id),
                });
                row.cells[index] = Some(Place { ranked, of: places.len() });
                let failed = ranked.entry.failed_tries.get(table.task.short_id()).copied().unwrap_or_default();
                let trials = ranked.cell.episodes + failed;
                row.rate.hits += (ranked.cell.strict_clean * trials as f64).round() as u64;
                row.rate.trials += trials;
            }
        }
    }
    let mut rows: Vec<PartialRow<'_>> = rows.into_values().collect();
    rows.sort_by(|a, b| {
        let more = b.tasks().cmp(&a.tasks()).then(b.share().total_cmp(&a.share()));
        a.division.cmp(b.division).then(more).then(a.entry.received.cmp(&b.entry.received))
    });
    rows
}
