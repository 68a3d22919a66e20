//! The rooms in which a ranking compares.
//!
//! Nobody may choose lucky rooms: replayed bags are of the fixed rooms from the first on, without a gap, and a hosted run has
//! at least as many rooms, which the server drew.

use std::collections::BTreeSet;

use fiatlux_grading::Results;
use fiatlux_proto::count as counted;
use fiatlux_rules::{SeedOwner, Task};

/// Smallest number of rooms of a ranked entry.
pub(crate) const MIN_ROOMS: usize = 4;
/// The rooms of replayed entries, in words.
pub(crate) const FIXED_ROOMS: &str = "0 to 3, and then 64, 65 and so on";

/// Those of the paper, then those for comparisons.
fn fixed() -> impl Iterator<Item = u64> {
    SeedOwner::Published.seeds().chain(SeedOwner::Seen.seeds())
}

/// Seed and index of the episodes of a subtask.
fn rooms_of(results: &Results, task: Task) -> BTreeSet<(u64, u64)> {
    let rows = results.episodes.iter().filter(|row| row.task == task.short_id());
    rows.map(|row| (row.seed, row.episode)).collect()
}

/// Checks that the rooms of a subtask were not chosen.
pub(super) fn check_rooms(results: &Results, task: Task, hosted: bool) -> Result<(), String> {
    let rooms = rooms_of(results, task);
    if rooms.iter().any(|(_, index)| *index != 0) {
        return Err("it has further episodes of a room; only the first of each room is ranked".into());
    }
    let count = rooms.len();
    if hosted {
        return match count < MIN_ROOMS {
            true => Err(format!("{}; a ranking takes at least {MIN_ROOMS}", counted(count, "hosted room"))),
            false => Ok(()),
        };
    }
    if results.conditions.seeds == "hosted" {
        return Err("its hosted rooms are not signed by a server of this board".into());
    }
    let is_fixed = fixed().take(count).eq(rooms.iter().map(|(seed, _)| *seed));
    match is_fixed && count >= MIN_ROOMS {
        true => Ok(()),
        false => Err(format!(
            "replayed entries are ranked in rooms {FIXED_ROOMS} without a gap, at least {MIN_ROOMS} of them"
        )),
    }
}

/// Checks that all twelve subtasks have the same rooms, and that these were not chosen.
pub(super) fn same_rooms(results: &Results, hosted: bool) -> Result<(), String> {
    let (lacking, played): (Vec<Task>, Vec<Task>) =
        Task::SUBTASKS.into_iter().partition(|task| rooms_of(results, *task).is_empty());
    if !lacking.is_empty() {
        let ids = |tasks: &[Task]| tasks.iter().map(|task| task.short_id()).collect::<Vec<_>>().join(", ");
        return Err(match played.is_empty() || lacking.len() <= played.len() {
            true => format!("no episode of {}", ids(&lacking)),
            false => format!("it played only {}", ids(&played)),
        });
    }
    let first = Task::SUBTASKS[0];
    let expected = rooms_of(results, first);
    if let Some(other) = Task::SUBTASKS.into_iter().find(|task| rooms_of(results, *task) != expected) {
        return Err(format!("{first} and {other} were not played in the same rooms; play all subtasks in all seeds"));
    }
    check_rooms(results, first, hosted)
}
