//! What makes a grading impossible as a whole. What is wrong with one bag only is a [`Fault`](crate::Fault).

use std::path::PathBuf;

use fiatlux_bag::FindError;
use fiatlux_bag::run::LedgerError;
use fiatlux_rules::{ThresholdError, UnknownTask};
use thiserror::Error;

/// Why no results came of a grading.
#[derive(Debug, Error)]
pub enum ScoreError {
    /// A threshold that cannot be set.
    #[error("--set cannot be used")]
    Threshold(#[from] ThresholdError),
    /// A path cannot be listed or found.
    #[error(transparent)]
    Path(#[from] FindError),
    /// Nothing to grade.
    #[error("there is no bag in {0}; name files or folders that hold *.mcap")]
    NoBags(String),
    /// Two bags whose results do not belong in one table.
    #[error(
        "bags of different conditions do not share a table: {field} is {first} in {first_bag} and {second} in \
         {second_bag}; grade them apart"
    )]
    Mixed {
        /// The condition.
        field: String,
        /// Its value in one bag.
        first: String,
        /// That bag.
        first_bag: String,
        /// Its value in another.
        second: String,
        /// The other bag.
        second_bag: String,
    },
    /// Two different recordings of one episode.
    #[error(
        "{first_bag} and {second_bag} are two different recordings of {task}, seed {seed}, episode {episode}; grade the \
         one that counts"
    )]
    Conflict {
        /// The task.
        task: String,
        /// Seed of the layout.
        seed: u64,
        /// The episode's index.
        episode: u64,
        /// A bag.
        first_bag: String,
        /// Another bag.
        second_bag: String,
    },
    /// Runs among the paths, but not one run alone.
    #[error(
        "a run is graded by itself, in its own folder; name one of {} (or, to grade bags as loose ones, the files)",
        .0.iter().map(|folder| folder.display().to_string()).collect::<Vec<_>>().join(", ")
    )]
    Runs(Vec<PathBuf>),
    /// A journal of the run.
    #[error("the run cannot be read")]
    Ledger(#[from] LedgerError),
    /// A journal whose signature is not of what it says.
    #[error("{}: its signature does not fit it; bring back the file as its server left it", .0.display())]
    Seal(PathBuf),
    /// Journals of different runs in one folder.
    #[error(
        "{} and {} are not journals of one run: the {field} differs; keep each run in a folder of its own",
        first.display(), second.display()
    )]
    Journals {
        /// A journal.
        first: PathBuf,
        /// Another journal.
        second: PathBuf,
        /// What differs.
        field: &'static str,
    },
    /// A run of tasks that this version does not know.
    #[error("{} has a task of another version; grade the run with the scorer of that version", path.display())]
    Task {
        /// The journal.
        path: PathBuf,
        /// The task.
        #[source]
        source: UnknownTask,
    },
    /// A worker died.
    #[error("a grading thread ended early; this is a fault of the scorer, please report the bags")]
    Worker,
}
