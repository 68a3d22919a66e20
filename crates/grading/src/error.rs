//! Errors that prevent a grading as a whole. A fault of a single bag is a [`Fault`](crate::Fault).

use std::path::PathBuf;

use fiatlux_bag::FindError;
use fiatlux_bag::run::LedgerError;
use fiatlux_rules::{ThresholdError, UnknownTask};
use thiserror::Error;

/// Why a grading gave no results.
#[derive(Debug, Error)]
pub enum ScoreError {
    /// A threshold of [`GradeOptions::set`](crate::GradeOptions::set) is unknown or out of range.
    #[error("--set cannot be used")]
    Threshold(#[from] ThresholdError),
    /// A path does not exist, or a folder cannot be listed.
    #[error(transparent)]
    Path(#[from] FindError),
    /// The paths hold no bag.
    #[error("there is no bag in {0}; name files or folders that hold *.mcap")]
    NoBags(String),
    /// Two bags were played or judged under different conditions.
    #[error(
        "bags of different conditions do not share a table: {field} is {first} in {first_bag} and {second} in \
         {second_bag}; grade them apart"
    )]
    Mixed {
        /// Name of the condition.
        field: String,
        /// Its value in the first bag.
        first: String,
        /// Path of the first bag.
        first_bag: String,
        /// Its value in the second bag.
        second: String,
        /// Path of the second bag.
        second_bag: String,
    },
    /// Two bags hold different recordings of one episode.
    #[error(
        "{first_bag} and {second_bag} are two different recordings of {task}, seed {seed}, episode {episode}; grade the \
         one that counts"
    )]
    Conflict {
        /// Id of the episode's task.
        task: String,
        /// Layout seed of the episode.
        seed: u64,
        /// Index of the episode.
        episode: u64,
        /// Path of one recording.
        first_bag: String,
        /// Path of the other recording.
        second_bag: String,
    },
    /// The paths hold a run, and other runs or bags.
    #[error(
        "a run is graded by itself, in its own folder; name one of {} (or, to grade bags as loose ones, the files)",
        .0.iter().map(|folder| folder.display().to_string()).collect::<Vec<_>>().join(", ")
    )]
    Runs(Vec<PathBuf>),
    /// A journal of the run cannot be read.
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
        /// Path of one journal.
        first: PathBuf,
        /// Path of the journal that disagrees with it.
        second: PathBuf,
        /// The first part of the registration that differs.
        field: &'static str,
    },
    /// Two journals of one server in one folder.
    #[error(
        "{} and {} are both journals of server {server}; keep the one that the server left, and move the other away",
        first.display(), second.display()
    )]
    Copies {
        /// Path of one journal.
        first: PathBuf,
        /// Path of the other.
        second: PathBuf,
        /// Name of the server.
        server: String,
    },
    /// The run has tasks that this version does not know.
    #[error("{} has a task of another version; grade the run with the scorer of that version", path.display())]
    Task {
        /// Path of the journal.
        path: PathBuf,
        /// The name that is not known.
        #[source]
        source: UnknownTask,
    },
    /// A grading thread panicked.
    #[error("a grading thread ended early; this is a fault of the scorer, please report the bags")]
    Worker,
}
