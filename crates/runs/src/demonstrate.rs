//! Demonstrations: plays a policy in one room after the other until enough episodes were clean.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

use fiatlux_client::RunProgress;
use fiatlux_grading::Results;
use fiatlux_rules::{SeedOwner, Task};

use crate::job::{EvaluateError, EvaluateOptions, Job, folder};
use crate::{Outcome, evaluate};

/// Folder of everything that was played, inside the output folder.
pub const PLAYED: &str = "played";
/// Folder of the demonstrations, inside the output folder.
pub const BAGS: &str = fiatlux_bag::BAGS;

/// Settings of demonstrations. `evaluation` says how to play: its folder is the output folder, its tasks and seeds are not read.
#[derive(Debug, Clone)]
pub struct DemonstrateOptions {
    pub evaluation: EvaluateOptions,
    pub task: Task,
    /// Number of demonstrations.
    pub episodes: usize,
    /// First room; later ones follow it.
    pub first_seed: u64,
    /// Number of rooms to play at most.
    pub max_rooms: usize,
    /// Episodes that failed, or in which a bulb was dropped or broken, count too.
    pub unclean: bool,
}

/// A demonstration.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Demonstration {
    pub seed: u64,
    /// Its bag.
    pub bag: PathBuf,
    pub steps: u64,
    /// It passes the strict gate, and nothing was dropped or broken.
    pub clean: bool,
}

/// The outcome of [`demonstrate`].
#[derive(Debug)]
pub struct Demonstrated {
    /// In the order of their rooms.
    pub kept: Vec<Demonstration>,
    /// Number of rooms that were played.
    pub rooms: usize,
    /// Number of those whose episode was clean.
    pub clean: usize,
    /// The last evaluation; it covers everything that was played.
    pub outcome: Outcome,
}

/// Plays rooms until there are enough demonstrations, and links their bags into the folder [`BAGS`]. Which they are follows from the
/// options alone: the first that count, in the order of rooms. Setting `stop` ends it early; a later call goes on.
///
/// # Errors
/// As of [`evaluate`]; a room that is not for training; a folder with demonstrations of another task.
pub fn demonstrate(
    options: &DemonstrateOptions,
    stop: &AtomicBool,
    progress: &mut dyn FnMut(usize, &RunProgress),
) -> Result<Demonstrated, EvaluateError> {
    SeedOwner::check_training(options.first_seed)?;
    SeedOwner::check_training(options.first_seed.saturating_add(options.max_rooms.saturating_sub(1) as u64))?;
    let out = &options.evaluation.out;
    let mut evaluation =
        EvaluateOptions { tasks: vec![options.task], out: out.join(PLAYED), ..options.evaluation.clone() };
    check_task(options.task, &evaluation.out)?;
    let mut rooms = options.episodes.min(options.max_rooms);
    loop {
        evaluation.seeds = (options.first_seed..).take(rooms).collect();
        let outcome = evaluate(&evaluation, stop, &mut |now| progress(rooms, now))?;
        let played = played(&outcome.results, options, &evaluation);
        let clean = played.iter().filter(|episode| episode.clean).count();
        let counts = if options.unclean { played.len() } else { clean };
        let is_over = outcome.stopped || counts >= options.episodes || rooms >= options.max_rooms || counts == 0;
        if is_over {
            let rooms = played.len();
            let counting = played.into_iter().filter(|episode| episode.clean || options.unclean);
            let kept = link(counting.take(options.episodes).collect(), &out.join(BAGS))?;
            return Ok(Demonstrated { kept, rooms, clean, outcome });
        }
        // As many more as will do if the share stays as it is.
        let missing = (options.episodes - counts) * rooms;
        rooms = (rooms + missing.div_ceil(counts)).min(options.max_rooms);
    }
}

/// Refuses a folder with episodes of another task: a data set would mix them unseen.
fn check_task(task: Task, played: &Path) -> Result<(), EvaluateError> {
    let Ok(entries) = fs::read_dir(played.join(BAGS)) else { return Ok(()) };
    for entry in entries.flatten() {
        if let Some(job) = entry.file_name().to_str().and_then(Job::of_bag)
            && job.task != task
        {
            let problem =
                format!("it holds demonstrations of {}, not {task}; name another folder with --out", job.task);
            return Err(folder(played, problem));
        }
    }
    Ok(())
}

/// Episodes of these rooms, in the order of rooms.
fn played(results: &Results, options: &DemonstrateOptions, evaluation: &EvaluateOptions) -> Vec<Demonstration> {
    let (task, seeds) = (options.task.to_string(), &evaluation.seeds);
    let rows = results.episodes.iter().filter(|row| row.task == task && seeds.contains(&row.seed));
    let mut played: Vec<Demonstration> = rows
        .map(|row| Demonstration {
            seed: row.seed,
            bag: evaluation.out.join(&row.bag),
            steps: row.steps,
            clean: row.strict_success == Some(true) && row.strict_clean == Some(true),
        })
        .collect();
    played.sort_by_key(|episode| episode.seed);
    played
}

/// Makes a folder hold the bags of these episodes and no other bag; their paths become those in it.
fn link(mut kept: Vec<Demonstration>, bags: &Path) -> Result<Vec<Demonstration>, EvaluateError> {
    fs::create_dir_all(bags).map_err(|error| folder(bags, error))?;
    let mut names = BTreeSet::new();
    for episode in &mut kept {
        let target = bags.join(episode.bag.file_name().unwrap_or_default());
        let _ = fs::remove_file(&target);
        let linked = fs::hard_link(&episode.bag, &target).or_else(|_| fs::copy(&episode.bag, &target).map(|_| ()));
        linked.map_err(|error| folder(&target, error))?;
        episode.bag.clone_from(&target);
        names.insert(target);
    }
    for entry in fs::read_dir(bags).map_err(|error| folder(bags, error))? {
        let path = entry.map_err(|error| folder(bags, error))?.path();
        let is_bag = path.file_name().and_then(|name| name.to_str()).and_then(Job::of_bag).is_some();
        if is_bag && !names.contains(&path) {
            fs::remove_file(&path).map_err(|error| folder(&path, error))?;
        }
    }
    Ok(kept)
}
