//! An episode: its replay in 3D, its verdicts, its figure, its bag.

use std::sync::Arc;

use askama::Template;
use axum::extract::{Path, State};
use axum::http::{HeaderMap, HeaderValue, Method, header};
use axum::response::Response;
use fiatlux_grading::{EpisodeRow, Results};
use fiatlux_replay::site::{SitePage, download, for_ever, one};
use fiatlux_replay::{Packed, PackedReplay};
use tokio::fs::File;

use super::answer::{Problem, content, page, replay_page, without_path};
use super::key::Key;
use super::run::PARTNERS;
use super::show;
use super::state::Pages;
use crate::{Entry, SubmissionId};

const JSON: &str = "application/json";
const BYTES: &str = "application/octet-stream";
/// The files of an episode change only with the version of the program.
const FOR_AN_HOUR: HeaderValue = HeaderValue::from_static("public, max-age=3600");

pub(super) struct FoundEpisode {
    pub entry: Entry,
    pub results: Arc<Results>,
    pub key: Key,
    index: usize,
}

impl FoundEpisode {
    pub fn row(&self) -> &EpisodeRow {
        &self.results.episodes[self.index]
    }

    fn neighbour(&self, at: Option<usize>) -> Option<Key> {
        at.and_then(|at| self.results.episodes.get(at)).and_then(Key::of)
    }
}

/// The episode that an address names.
pub(super) async fn find(pages: &Pages, id: &str, key: &str) -> Result<FoundEpisode, Problem> {
    let key: Key = key.parse().map_err(|()| Problem::Nothing)?;
    let (entry, results) = pages.run(id).await?;
    let index = results.episodes.iter().position(|row| key.is_of(row)).ok_or(Problem::Nothing)?;
    Ok(FoundEpisode { entry, results, key, index })
}

#[derive(Template)]
#[template(path = "episode.html")]
struct EpisodePage<'a> {
    entry: &'a Entry,
    row: &'a EpisodeRow,
    key: Key,
    /// `None` if the episode counts as a failure without a bag.
    replay: Option<&'a SitePage>,
    before: Option<Key>,
    after: Option<Key>,
    others: Vec<&'a Entry>,
}

impl EpisodePage<'_> {
    /// Cause of the end, steps and progress by the strict judge; `None` if the results have none.
    fn strict(&self) -> Option<(&str, u64, f64)> {
        let row = self.row;
        Some((row.strict_end.as_deref().unwrap_or("cut"), row.strict_steps?, row.strict_progress?))
    }
}

pub(super) async fn episode(
    State(pages): State<Arc<Pages>>,
    Path((id, key)): Path<(String, String)>,
) -> Result<Response, Problem> {
    let found = find(&pages, &id, &key).await?;
    let board = pages.board_with(found.entry.id).await?;
    let has =
        |id| board.played(id).is_some_and(|p| p.has(found.key.task.short_id(), found.key.seed, found.key.episode));
    let others = board.partners(found.entry.id).into_iter().map(|(entry, _)| entry).filter(|entry| has(entry.id));
    let others = others.take(PARTNERS).collect();
    let replay = one();
    let shown = EpisodePage {
        entry: &found.entry,
        row: found.row(),
        key: found.key,
        replay: found.row().failure.is_none().then_some(&replay),
        before: found.neighbour(found.index.checked_sub(1)),
        after: found.neighbour(Some(found.index + 1)),
        others,
    };
    Ok(if shown.replay.is_some() { replay_page(&shown, &replay.script) } else { page(&shown) })
}

/// The document that the replay page reads first, as JSON.
pub(super) async fn document(
    state: State<Arc<Pages>>,
    asked: HeaderMap,
    path: Path<(String, String)>,
) -> Result<Response, Problem> {
    part(state, asked, path, JSON, |shown| shown.document).await
}

/// The shapes of the replay's scene, as the replay page reads them.
pub(super) async fn meshes(
    state: State<Arc<Pages>>,
    asked: HeaderMap,
    path: Path<(String, String)>,
) -> Result<Response, Problem> {
    part(state, asked, path, BYTES, |shown| shown.meshes).await
}

/// The recorded rows, as the replay page reads them.
pub(super) async fn track(
    state: State<Arc<Pages>>,
    asked: HeaderMap,
    path: Path<(String, String)>,
) -> Result<Response, Problem> {
    part(state, asked, path, BYTES, |shown| shown.track).await
}

/// Shapes by their digest, which replays of several episodes share.
pub(super) async fn shapes(
    State(pages): State<Arc<Pages>>,
    asked: HeaderMap,
    Path(digest): Path<String>,
) -> Result<Response, Problem> {
    let block = pages.replays.block(&digest).ok_or(Problem::Nothing)?;
    Ok(for_ever(block.answer(&asked, BYTES)))
}

/// Angles, targets and efforts of the joints, as the replay page reads them.
pub(super) async fn joints(
    state: State<Arc<Pages>>,
    asked: HeaderMap,
    path: Path<(String, String)>,
) -> Result<Response, Problem> {
    part(state, asked, path, BYTES, |shown| shown.joints).await
}

/// The head camera's pictures, as the replay page reads them.
pub(super) async fn pictures(
    state: State<Arc<Pages>>,
    asked: HeaderMap,
    path: Path<(String, String)>,
) -> Result<Response, Problem> {
    part(state, asked, path, BYTES, |shown| shown.pictures).await
}

async fn part(
    State(pages): State<Arc<Pages>>,
    asked: HeaderMap,
    Path((id, key)): Path<(String, String)>,
    kind: &'static str,
    part: fn(PackedReplay) -> Packed,
) -> Result<Response, Problem> {
    let (id, key) = names(&pages, &id, &key).await?;
    let bag = pages.service.store.bag(id, key.task.short_id(), key.seed, key.episode).await?.ok_or(Problem::Nothing)?;
    let replays = Arc::clone(&pages.replays);
    let name = format!("{key}.mcap");
    let path = bag.clone();
    let shown = pages.heavy.read(&bag, move |patience| {
        let shown = replays.show(&path, Some(&name), Some(patience));
        shown.map_err(|error| Problem::Unshowable(without_path(&error, &path, &name)))
    });
    Ok(for_an_hour(part(shown.await??).answer(&asked, kind)))
}

/// The episode of an address, if its run is public.
async fn names(pages: &Pages, id: &str, key: &str) -> Result<(SubmissionId, Key), Problem> {
    let key: Key = key.parse().map_err(|()| Problem::Nothing)?;
    Ok((pages.open(id).await?.id, key))
}

/// The bag, byte for byte as it was submitted or made thin since, whole or in part.
pub(super) async fn bag(
    State(pages): State<Arc<Pages>>,
    method: Method,
    asked: HeaderMap,
    Path((id, key)): Path<(String, String)>,
) -> Result<Response, Problem> {
    let (id, key) = names(&pages, &id, &key).await?;
    let bag = pages.service.store.bag(id, key.task.short_id(), key.seed, key.episode).await?.ok_or(Problem::Nothing)?;
    let failed = |error: std::io::Error| {
        tracing::error!("a bag cannot be read: {error}");
        Problem::Failed
    };
    let file = File::open(&bag).await.map_err(failed)?;
    // Its file is named by its digest.
    let digest = bag.file_name().unwrap_or_default().to_string_lossy();
    let mut answer = for_an_hour(download(file, &digest, BYTES, &method, &asked).await.map_err(failed)?);
    if let Ok(name) = HeaderValue::try_from(format!("attachment; filename=\"{key}.mcap\"")) {
        answer.headers_mut().insert(header::CONTENT_DISPOSITION, name);
    }
    Ok(answer)
}

/// The criteria and the force on the hands over time, as a picture.
pub(super) async fn figure(
    State(pages): State<Arc<Pages>>,
    Path((id, key)): Path<(String, String)>,
) -> Result<Response, Problem> {
    let found = find(&pages, &id, &key).await?;
    let drawn = pages.figure(found.entry.id, found.key, found.results).await?;
    let figure = drawn.ok_or_else(|| Problem::Unshowable("The bag has no row that can be drawn.".into()))?;
    let mut answer = for_an_hour(content("image/svg+xml", figure));
    // The figure has an inline style; nothing else is allowed.
    let policy = HeaderValue::from_static("default-src 'none'; style-src 'unsafe-inline'; sandbox");
    answer.headers_mut().insert(header::CONTENT_SECURITY_POLICY, policy);
    Ok(answer)
}

fn for_an_hour(mut answer: Response) -> Response {
    answer.headers_mut().insert(header::CACHE_CONTROL, FOR_AN_HOUR);
    answer
}
