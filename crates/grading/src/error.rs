//! Errors that prevent a grading as a whole. A fault of a single bag is a [`Fault`](crate::Fault).

use std::path::PathBuf;

use fiatlux_bag::run::LedgerError;
use fiatlux_bag::{BagError, FindError};
use fiatlux_rules::{ThresholdError, UnknownTask};
use thiserror::Error;

#[derive(Debug, Error)]
pub enum ScoreError {
    #[error("--set cannot be used")]
    Threshold(#[from] ThresholdError),
    #[error(transparent)]
    Path(#[from] FindError),
    #[error("there is no bag in {0}; name files or folders that hold *.mcap")]
    NoBags(String),
    #[error(
        "bags of different conditions do not share a table: {field} is {first} in {first_bag} and {second} in \
         {second_bag}; grade them apart"
    )]
    Mixed { field: String, first: String, first_bag: String, second: String, second_bag: String },
    #[error(
        "{first_bag} and {second_bag} are two different recordings of {task}, seed {seed}, episode {episode}; grade the \
         one that counts"
    )]
    Conflict { task: String, seed: u64, episode: u64, first_bag: String, second_bag: String },
    #[error(
        "a run is graded by itself, in its own folder; name one of {} (or, to grade bags as loose ones, the files)",
        .0.iter().map(|folder| folder.display().to_string()).collect::<Vec<_>>().join(", ")
    )]
    Runs(Vec<PathBuf>),
    #[error(
        "{} and {} are not parts of one evaluation: they have different {field}; grade them apart",
        first.display(), second.display()
    )]
    Parts { first: PathBuf, second: PathBuf, field: &'static str },
    #[error(
        "{task}, seed {seed} is in {} and in {} with different outcomes, and counts once; leave out the part that is not to \
         count, or play the parts in different rooms",
        first.display(), second.display()
    )]
    Twice { task: String, seed: u64, first: PathBuf, second: PathBuf },
    #[error("the run cannot be read")]
    Ledger(#[from] LedgerError),
    #[error("{}: its signature does not fit its lines; restore the file as its server wrote it", .0.display())]
    Seal(PathBuf),
    #[error(
        "{} and {} are not journals of one run: the {field} differs; keep each run in a folder of its own",
        first.display(), second.display()
    )]
    Journals { first: PathBuf, second: PathBuf, field: &'static str },
    #[error(
        "{} and {} are both journals of server {server}; keep the server's own, and move the other away",
        first.display(), second.display()
    )]
    Copies { first: PathBuf, second: PathBuf, server: String },
    #[error(
        "run {run} was registered with server {server} after server {other} had finished it: its hosted seeds were known by then; play a \
         new run"
    )]
    Late { run: String, server: String, other: String },
    #[error("{} has a task of another version; grade the run with the scorer of that version", path.display())]
    Task { path: PathBuf, source: UnknownTask },
    /// The machine failed, see [`BagError::is_of_machine`].
    #[error("a bag cannot be graded on this machine now; grade again afterwards")]
    Machine(#[from] BagError),
    #[error("a grading thread ended early; this is a fault of the scorer, please report the bags")]
    Worker,
}
