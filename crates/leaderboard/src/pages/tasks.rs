//! The rankings of single subtasks, and the pictures of the best successes.

use std::sync::Arc;

use askama::Template;
use axum::extract::{Path, State};
use axum::http::{HeaderValue, header};
use axum::response::Response;
use fiatlux_rules::{Protocol, Task};

use super::answer::{Problem, content, page};
use super::key::Key;
use super::show;
use super::state::{Board, Pages};
use crate::standings::{RankedTask, TaskTable};
use crate::store::{Digest, Picture};
use crate::{Division, SubmissionId};

/// Rows of a ranking on the page.
const ROWS: usize = 50;
/// A submission's pictures never change.
const FOR_A_DAY: HeaderValue = HeaderValue::from_static("public, max-age=86400");

/// A subtask, with the best success of each division.
pub(super) struct Card<'a> {
    pub task: Task,
    pub bests: Vec<Best<'a>>,
    /// The submission whose pictures the card shows, and the pictured episode.
    pub pictured: Option<(SubmissionId, Key)>,
}

pub(super) struct Best<'a> {
    /// The division in a few words.
    pub division: String,
    pub place: &'a RankedTask,
}

pub(super) fn cards(board: &Board) -> Vec<Card<'_>> {
    board.tasks.iter().map(|table| card(board, table)).collect()
}

fn card<'a>(board: &'a Board, table: &'a TaskTable) -> Card<'a> {
    let bests: Vec<_> = table.best().map(|(division, place)| Best { division: show::brief(division), place }).collect();
    let task = table.task;
    let pictured = bests.iter().find_map(|best| {
        let picture = board.picture(best.place.entry.id, task.short_id())?;
        Some((best.place.entry.id, Key { task, seed: picture.seed, episode: picture.episode }))
    });
    Card { task, bests, pictured }
}

struct DivisionRanking<'a> {
    division: &'a Division,
    places: &'a [RankedTask],
    more: usize,
}

#[derive(Template)]
#[template(path = "subtask.html")]
struct SubtaskPage<'a> {
    card: Card<'a>,
    groups: Vec<DivisionRanking<'a>>,
    /// Criteria of the strict gate, in words.
    criteria: Vec<String>,
    before: Option<Task>,
    after: Option<Task>,
}

pub(super) async fn task(State(pages): State<Arc<Pages>>, Path(task): Path<String>) -> Result<Response, Problem> {
    let task = subtask(&task)?;
    let board = pages.board().await?;
    let table = board.tasks.iter().find(|table| table.task == task).ok_or(Problem::Nothing)?;
    let groups = table.divisions.iter().map(|(division, places)| DivisionRanking {
        division,
        places: &places[..places.len().min(ROWS)],
        more: places.len().saturating_sub(ROWS),
    });
    let index = Task::SUBTASKS.iter().position(|other| *other == task).unwrap_or_default();
    let criteria = task.spec().gate.criteria_of(Protocol::Strict);
    Ok(page(&SubtaskPage {
        card: card(&board, table),
        groups: groups.collect(),
        criteria: criteria.map(|criterion| criterion.name.replace('_', " ")).collect(),
        before: index.checked_sub(1).map(|index| Task::SUBTASKS[index]),
        after: Task::SUBTASKS.get(index + 1).copied(),
    }))
}

/// A picture of a submission's best success in a subtask.
pub(super) async fn still(state: State<Arc<Pages>>, path: Path<(String, String)>) -> Result<Response, Problem> {
    picture(state, path, |picture| &picture.still).await
}

/// The same success as a moving picture.
pub(super) async fn clip(state: State<Arc<Pages>>, path: Path<(String, String)>) -> Result<Response, Problem> {
    picture(state, path, |picture| &picture.clip).await
}

async fn picture(
    State(pages): State<Arc<Pages>>,
    Path((id, task)): Path<(String, String)>,
    file: fn(&Picture) -> &Digest,
) -> Result<Response, Problem> {
    let (entry, task) = (pages.open(&id).await?, subtask(&task)?);
    let board = pages.board().await?;
    let found = board.picture(entry.id, task.short_id()).ok_or(Problem::Nothing)?;
    let bytes = pages.service.store.blobs.read(file(found)).await?;
    let mut answer = content("image/png", bytes);
    answer.headers_mut().insert(header::CACHE_CONTROL, FOR_A_DAY);
    Ok(answer)
}

/// A subtask by its short id in our spelling: a page has one address.
pub(super) fn subtask(text: &str) -> Result<Task, Problem> {
    let found = Task::SUBTASKS.into_iter().find(|task| task.short_id() == text);
    found.ok_or(Problem::Nothing)
}
