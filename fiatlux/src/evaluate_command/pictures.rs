//! Replays and stills of a run's episodes, to which its report leads.

use std::fs;
use std::num::NonZeroUsize;
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::thread;

use anyhow::Context;
use fiatlux_bag::{Bag, Patience};
use fiatlux_cli::{ProgressLine, in_full, write_whole};
use fiatlux_grading::report::REPLAYS;
use fiatlux_grading::{EpisodeRow, Results};
use fiatlux_replay::{Poster, Replay, standalone};

/// Maximum number of episodes that get them, as many of each task: a replay takes 1 to 2 MB and a second.
const MAX_EPISODES: usize = 48;

/// Writes the replay and the still of a run's first episodes into its folder, unless they are there or `stop` is set; true if it wrote
/// some. Nothing depends on them: what cannot be drawn is said, and left out. Bags without rows are left out, because their episodes
/// would be simulated again; a line says so.
pub(super) fn draw(out: &Path, results: &Results, stop: &AtomicBool) -> bool {
    let episodes = chosen(results);
    let (next, drawn, thin) = (AtomicUsize::new(0), AtomicBool::new(false), AtomicBool::new(false));
    let line = ProgressLine::default();
    let work = || {
        loop {
            let index = next.fetch_add(1, Ordering::Relaxed);
            let Some(episode) = episodes.get(index) else { return };
            line.show(|| format!("replay {} of {}", index + 1, episodes.len()));
            if stop.load(Ordering::Relaxed) {
                return;
            }
            match draw_one(out, episode) {
                Ok(Done::Drew) => drawn.store(true, Ordering::Relaxed),
                Ok(Done::WasDrawn) => {}
                Ok(Done::IsThin) => thin.store(true, Ordering::Relaxed),
                Err(error) => line.write_over(|| {
                    fiatlux_cli::report(format!("no replay of {}: {}", episode.bag, in_full(&*error)));
                }),
            }
        }
    };
    let threads = thread::available_parallelism().map_or(1, NonZeroUsize::get).min(episodes.len());
    thread::scope(|scope| (0..threads).for_each(|_| drop(scope.spawn(work))));
    line.clear();
    if thin.into_inner() {
        fiatlux_cli::report(
            "no replays and stills: thin bags have no rows; fiatlux view BAG --out PAGE.html simulates those of one",
        );
    }
    drawn.into_inner()
}

/// The end of the drawing of an episode's replay and still.
enum Done {
    Drew,
    WasDrawn,
    IsThin,
}

/// The first episodes of each task.
fn chosen(results: &Results) -> Vec<&EpisodeRow> {
    let tasks: Vec<_> = results.episodes.chunk_by(|a, b| a.task == b.task).collect();
    let each = (MAX_EPISODES / tasks.len().max(1)).max(1);
    tasks.into_iter().flat_map(|rows| rows.iter().filter(|row| row.failure.is_none()).take(each)).collect()
}

/// Draws an episode, unless it was drawn before, or is without rows.
fn draw_one(out: &Path, episode: &EpisodeRow) -> anyhow::Result<Done> {
    let bag = out.join(&episode.bag);
    let place = out.join(REPLAYS).join(bag.file_name().unwrap_or_default());
    let (replay, still) = (place.with_extension("html"), place.with_extension("png"));
    let time = |file: &Path| fs::metadata(file).and_then(|file| file.modified()).ok();
    let is_drawn = |file: &Path| time(file).is_some_and(|drawn| time(&bag).is_none_or(|recorded| recorded <= drawn));
    if is_drawn(&replay) && is_drawn(&still) {
        return Ok(Done::WasDrawn);
    }
    if Bag::open(&bag)?.is_thin() {
        return Ok(Done::IsThin);
    }
    fs::create_dir_all(out.join(REPLAYS)).context("cannot make its folder")?;
    write_whole(&replay, standalone(&Replay::open(&bag)?)).context("cannot be written")?;
    write_whole(&still, Poster::draw_still(&bag, &Patience::new(|| true))?).context("its still cannot be written")?;
    Ok(Done::Drew)
}
