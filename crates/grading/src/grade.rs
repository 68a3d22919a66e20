//! Grades bags, several at a time.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, OnceLock};
use std::time::{Duration, Instant};

use fiatlux_bag::{Bag, Patience};
use fiatlux_rules::Thresholds;

use crate::assemble::{BagContent, GradedBag, assemble, assemble_run};
use crate::bag::{self, Ungraded};
use crate::conditions::is_take;
use crate::find::{find_bags, relative, runs_of};
use crate::results::{Fault, Results};
use crate::run::RunJournals;
use crate::{GradeOptions, ScoreError};

/// Time in which a step of a thin bag is simulated, five times that of a free core.
const STEP_TIME: Duration = Duration::from_millis(1);

/// Patience with a bag that ends at a time after reading began; a thin bag has time to be simulated as well.
pub fn patience(limit: Duration, bag: &Path) -> Patience {
    let (end, bag) = (OnceLock::new(), bag.to_owned());
    Patience::new(move || Instant::now() < *end.get_or_init(|| Instant::now() + limit + simulation_time(&bag)))
}

fn simulation_time(bag: &Path) -> Duration {
    let thin = Bag::open(bag).ok().filter(Bag::is_thin);
    let steps = thin.and_then(|bag| Some(bag.result()?.end.as_ref()?.steps)).unwrap_or_default();
    // More steps than any task has are not simulated at all.
    STEP_TIME * u32::try_from(steps).unwrap_or_default()
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct GradeProgress {
    pub bags_done: usize,
    pub bags: usize,
    pub bytes_done: u64,
    pub bytes: u64,
}

/// Grades the bags in files and folders (to any depth) from their rows alone.
///
/// Bags that are cut, aborted, altered or unreadable are listed in [`Results::excluded`] and not scored; so are further
/// copies of an episode. The results depend only on the bags, their names and the options.
///
/// A folder with the journal of a run is graded as that run ([`Results::run`]): each registered episode counts, either
/// by the bag that a journal names or as a failure. Other bags in the folder do not count. Several such folders are one
/// result if they are of one run, whose servers recorded on different machines, or of runs of one policy in different rooms,
/// such as the shards of an evaluation.
///
/// # Errors
/// [`ScoreError`]: an unknown threshold, a missing path, no bag at all, bags of different conditions, two different
/// recordings of one episode, a journal that cannot be read, a run together with loose bags, runs that are not parts of one
/// evaluation, or a machine that cannot read a bag or has no room for the rows of a thin one.
pub fn grade(
    paths: &[PathBuf],
    options: &GradeOptions,
    progress: &(dyn Fn(GradeProgress) + Sync),
) -> Result<Results, ScoreError> {
    let mut thresholds = Thresholds::default();
    options.set.iter().try_for_each(|assignment| thresholds.set(assignment))?;
    let found = find_bags(paths)?;
    let folder = options.folder();
    if let Some(folders) = runs_of(&found)? {
        return grade_run(&RunJournals::read(folders)?, options, progress);
    }

    let unfinished = found.unfinished.iter().map(|path| GradedBag {
        bag: relative(path, folder),
        content: Err((Fault::Unfinished, "its recording was never finished; its recorder may still be running".into())),
    });
    let mut judged: Vec<GradedBag> = unfinished.collect();
    let contents = each_bag(&found.bags, options, progress)?;
    judged.extend(
        found.bags.iter().zip(contents).map(|(path, content)| GradedBag { bag: relative(path, folder), content }),
    );
    assemble(judged, options)
}

fn grade_run(
    run: &RunJournals,
    options: &GradeOptions,
    progress: &(dyn Fn(GradeProgress) + Sync),
) -> Result<Results, ScoreError> {
    let (there, lost): (Vec<_>, Vec<_>) = run.bags().into_iter().partition(|(_, path)| path.is_file());
    let paths: Vec<PathBuf> = there.iter().map(|(_, path)| path.clone()).collect();
    let read = there.into_iter().zip(each_bag(&paths, options, progress)?);
    let gone = || Err((Fault::Lost, "by the journal it was played, but its bag is missing; restore the file".into()));
    let all = read.chain(lost.into_iter().map(|lost| (lost, gone())));
    let judged =
        all.map(|((index, path), content)| (index, GradedBag { bag: relative(&path, options.folder()), content }));
    assemble_run(run, judged.collect(), options)
}

/// Refuses takes where episodes of policies are graded, and the other way round.
fn of_kind(content: BagContent, options: &GradeOptions) -> BagResult {
    match (is_take(&content.header), options.takes) {
        (true, false) => {
            Err((Fault::Kind, "it is a take, which a person drove; grade takes by themselves with --takes".into()))
        }
        (false, true) => Err((Fault::Kind, "it is not a take; grade it without --takes".into())),
        _ => Ok(content),
    }
}

type BagResult = Result<BagContent, (Fault, String)>;

/// Grades the bags, and returns them in the order given. The largest are graded first, so that no thread starts one at
/// the end.
fn each_bag(
    bags: &[PathBuf],
    options: &GradeOptions,
    progress: &(dyn Fn(GradeProgress) + Sync),
) -> Result<Vec<BagResult>, ScoreError> {
    let sizes: Vec<u64> = bags.iter().map(|path| path.metadata().map_or(0, |data| data.len())).collect();
    let mut order: Vec<usize> = (0..bags.len()).collect();
    order.sort_by_key(|i| (std::cmp::Reverse(sizes[*i]), *i));
    let workers = match options.workers {
        0 => std::thread::available_parallelism().map_or(1, usize::from),
        n => n,
    };
    let next = AtomicUsize::new(0);
    let start = GradeProgress { bags_done: 0, bags: bags.len(), bytes_done: 0, bytes: sizes.iter().sum() };
    let done = Mutex::new(start);
    let work = || {
        let mut contents = Vec::new();
        while let Some(&i) = order.get(next.fetch_add(1, Ordering::Relaxed)) {
            let limit = options.time_limit.map(|limit| patience(limit, &bags[i]));
            let content = match bag::read(&bags[i], options, limit) {
                Ok(content) => Ok(of_kind(content, options)),
                Err(Ungraded::Excluded(fault, reason)) => Ok(Err((fault, reason))),
                Err(Ungraded::Machine(error)) => {
                    // Others would fail as well.
                    next.store(order.len(), Ordering::Relaxed);
                    Err(error.into())
                }
            };
            contents.push((i, content));
            if let Ok(mut done) = done.lock() {
                done.bags_done += 1;
                done.bytes_done += sizes[i];
                progress(*done);
            }
        }
        contents
    };
    let mut contents: Vec<(usize, Result<BagResult, ScoreError>)> = std::thread::scope(|scope| {
        let threads: Vec<_> = (0..workers.min(bags.len())).map(|_| scope.spawn(work)).collect();
        let results = threads.into_iter().map(|thread| thread.join().map_err(|_| ScoreError::Worker));
        results.collect::<Result<Vec<_>, _>>()
    })?
    .into_iter()
    .flatten()
    .collect();
    contents.sort_by_key(|(i, _)| *i);
    contents.into_iter().map(|(_, content)| content).collect()
}
