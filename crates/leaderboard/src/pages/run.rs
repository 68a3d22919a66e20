//! A run: its manifest, its report, its episodes.

use std::sync::Arc;

use askama::Template;
use axum::extract::{Path, RawQuery, State};
use axum::http::HeaderMap;
use axum::response::Response;
use fiatlux_grading::report::{self, Site, SiteReport};
use fiatlux_grading::{EpisodeRow, Results};
use fiatlux_rules::Task;

use super::answer::{Problem, page, site_of};
use super::key::Key;
use super::show;
use super::state::Pages;
use crate::{Entry, SubmissionId};

/// Maximum number of episodes on a page of a task.
const MANY: usize = 24;
/// Maximum number of squares of a task.
const SQUARES: usize = 64;

/// Maximum number of runs that are offered for a comparison.
pub(super) const PARTNERS: usize = 40;

/// The episodes of one task, and the one that has pictures.
struct TaskLine<'a> {
    task: Task,
    pictured: Option<Key>,
    passed: usize,
    count: usize,
    /// Rank in the subtask, and number of rows of its ranking; `None` if it is not ranked there.
    place: Option<(Option<usize>, usize)>,
    squares: Vec<(Key, &'a EpisodeRow)>,
}

#[derive(Template)]
#[template(path = "run.html")]
struct RunPage<'a> {
    site: String,
    entry: &'a Entry,
    results: &'a Results,
    report: SiteReport,
    /// Rank, number of rows of the table, and the table's address; `None` if the run is not ranked.
    place: Option<(Option<usize>, usize, String)>,
    /// Runs that share episodes with it, and the number of those.
    others: Vec<(&'a Entry, usize)>,
    lines: Vec<TaskLine<'a>>,
    /// An episode with a bag, for the commands on the page.
    example: Option<Key>,
}

pub(super) async fn run(
    State(pages): State<Arc<Pages>>,
    asked: HeaderMap,
    Path(id): Path<String>,
) -> Result<Response, Problem> {
    let (entry, results) = pages.run(&id).await?;
    let board = pages.board_with(entry.id).await?;
    let found = board.place(entry.id);
    let place = found.map(|(table, index)| {
        let address = format!("/?division={}", show::slug(table.version, &table.division));
        (table.places[index].rank, table.places.len(), address)
    });
    let others = board.partners(entry.id).into_iter().take(PARTNERS).collect();
    let picture = |task: Task| {
        let picture = board.picture(entry.id, task.short_id())?;
        Some(Key { task, seed: picture.seed, episode: picture.episode })
    };
    let tasks = results.episodes.chunk_by(|a, b| a.task == b.task);
    let lines = tasks.filter_map(|rows| line(rows, picture, |task| board.task_place(entry.id, task))).collect();
    let example = results.episodes.iter().find(|row| row.failure.is_none()).and_then(Key::of);
    let (report, site) = (report::site(&results), site_of(&asked));
    Ok(page(&RunPage { site, entry: &entry, results: &results, report, place, others, lines, example }))
}

fn line(
    rows: &[EpisodeRow],
    picture: impl Fn(Task) -> Option<Key>,
    place: impl Fn(Task) -> Option<(Option<usize>, usize)>,
) -> Option<TaskLine<'_>> {
    let task = rows.first()?.task.parse().ok()?;
    let passed = rows.iter().filter(|row| row.strict_success.unwrap_or(row.clean)).count();
    let squares = rows.iter().take(SQUARES).filter_map(|row| Some((Key::of(row)?, row))).collect();
    Some(TaskLine { task, pictured: picture(task), passed, count: rows.len(), place: place(task), squares })
}

/// Calls `report` with the addresses of a run's episodes.
fn in_addresses<T>(id: SubmissionId, report: impl FnOnce(&Site<'_>) -> T) -> T {
    let of = |row: &EpisodeRow| Key::of(row).map_or_else(String::new, |key| format!("/runs/{id}/episodes/{key}"));
    report(&Site { episode: &of, figure: &|row| format!("{}/figure.svg", of(row)) })
}

#[derive(Template)]
#[template(path = "task.html")]
struct TaskPage<'a> {
    entry: &'a Entry,
    task: Task,
    count: usize,
    cards: String,
    page: usize,
    pages: usize,
}

pub(super) async fn task(
    State(pages): State<Arc<Pages>>,
    Path((id, task)): Path<(String, String)>,
    RawQuery(query): RawQuery,
) -> Result<Response, Problem> {
    let (entry, results) = pages.run(&id).await?;
    let task = task.parse::<Task>().ok().filter(|found| found.short_id() == task).ok_or(Problem::Nothing)?;
    let is_of_task = |row: &&EpisodeRow| row.task == task.short_id();
    let rows: Vec<EpisodeRow> = results.episodes.iter().filter(is_of_task).cloned().collect();
    if rows.is_empty() {
        return Err(Problem::Nothing);
    }
    let part = show::part(&rows, MANY, query.as_deref());
    let cards = in_addresses(entry.id, |site| report::task_cards(&results, part.shown, site));
    Ok(page(&TaskPage { entry: &entry, task, count: rows.len(), cards, page: part.page, pages: part.pages }))
}

#[cfg(test)]
mod tests {
    use fiatlux_grading::Results;

    use super::*;
    use crate::standings::tests::{entry, hosted};

    /// Guards that a run which is ranked in a subtask is not said to be unranked, and that one which is ranked nowhere is.
    #[test]
    fn a_run_says_where_it_is_ranked() {
        let said = |change: fn(&mut Results)| {
            let mut results = hosted(12);
            results.conditions.observations = "goal".into();
            results.episodes.retain(|row| row.task == "S01");
            results.subtasks.truncate(1);
            change(&mut results);
            let entry = entry(1, "carry", &results);
            let is_ranked = entry.tasks.iter().any(|task| task == "S01");
            let lines = line(&results.episodes, |_| None, |_| is_ranked.then_some((Some(1), 2))).into_iter().collect();
            let (report, site) = (report::site(&results), String::new());
            let (place, others, example) = (None, Vec::new(), None);
            let page = RunPage { site, entry: &entry, results: &results, report, place, others, lines, example };
            page.render().expect("rendered")
        };
        let ranked = said(|_| {});
        assert!(ranked.contains("<b>Ranked in S01</b>, and not among all twelve: it played only S01."), "{ranked}");
        assert!(
            ranked.contains("Hosted: lockstep, goal observations") && ranked.contains(">rank 1 of 2</a>"),
            "{ranked}"
        );
        assert!(!ranked.contains("panel warn") && !ranked.contains("Score S"), "{ranked}");
        let nowhere = said(|results| results.episodes.truncate(1));
        assert!(nowhere.contains("<b>Not ranked:</b> 1 hosted room; a ranking takes at least 4."), "{nowhere}");
        assert!(!nowhere.contains("Ranked in") && !nowhere.contains("all twelve"), "{nowhere}");
    }
}
