//! Draws pictures of a submission while it is verified: the best success of each subtask. The time is limited, and pictures that
//! fail are left out: nothing depends on them.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use fiatlux_bag::Patience;
use fiatlux_cli::in_full;
use fiatlux_grading::{EpisodeRow, Results, patience};
use fiatlux_replay::Poster;
use fiatlux_rules::Task;

use crate::store::Picture;
use crate::{Service, StoreError, SubmissionId};

/// Time limit for the pictures of one episode, without simulating a thin bag.
const LIMIT: Duration = Duration::from_secs(30);

/// Draws one submission, and stores its pictures. Returns `false` if none was waiting.
pub(super) async fn draw_next(service: &Arc<Service>, stop: &Arc<AtomicBool>) -> Result<bool, StoreError> {
    let store = &service.store;
    let Some(id) = store.next_undrawn().await? else { return Ok(false) };
    if let Some(results) = store.results(id).await? {
        let drawn = store.pictured(id).await?;
        for (task, row) in best(&results) {
            if drawn.contains(task) {
                continue;
            }
            let Some(bag) = store.bag(id, task, row.seed, row.episode).await? else { continue };
            let Some(poster) = poster(id, bag, Arc::clone(stop)).await else { continue };
            let (still, clip) = (store.blobs.put(poster.still).await?, store.blobs.put(poster.clip).await?);
            let picture = Picture { seed: row.seed, episode: row.episode, still, clip };
            store.set_picture(id, task, &picture).await?;
        }
    }
    // A service that stops draws the rest after its next start.
    if !stop.load(Ordering::Relaxed) {
        store.set_drawn(id).await?;
        tracing::info!(submission = %id, "drawn");
    }
    Ok(true)
}

/// The best success of each subtask: clean by the strict judge, and the fastest of these.
fn best(results: &Results) -> BTreeMap<&'static str, &EpisodeRow> {
    let mut best: BTreeMap<&str, &EpisodeRow> = BTreeMap::new();
    for row in &results.episodes {
        let Some(task) = row.task.parse().ok().filter(|task| Task::SUBTASKS.contains(task)) else { continue };
        let key = |row: &EpisodeRow| (row.strict_steps, row.seed, row.episode);
        if row.failure.is_none() && row.strict_clean == Some(true) {
            let slot = best.entry(task.short_id()).or_insert(row);
            if key(row) < key(slot) {
                *slot = row;
            }
        }
    }
    best
}

/// Pictures of a bag, drawn on a separate thread; `None` if they cannot be drawn in time.
async fn poster(id: SubmissionId, bag: std::path::PathBuf, stop: Arc<AtomicBool>) -> Option<Poster> {
    let draw = move || {
        let limit = patience(LIMIT, &bag);
        let drawn = Poster::draw(&bag, &Patience::new(move || limit.goes_on() && !stop.load(Ordering::Relaxed)));
        drawn.inspect_err(|error| warn(id, &bag, error)).ok()
    };
    tokio::task::spawn_blocking(draw).await.ok().flatten()
}

fn warn(id: SubmissionId, bag: &Path, error: &fiatlux_replay::ReplayError) {
    tracing::warn!(submission = %id, bag = %bag.display(), error = in_full(error), "no pictures of this bag");
}
