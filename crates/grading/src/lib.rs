//! Grades bags: from recorded rows to scores, tables and a report.
//!
//! [`grade`] reads bags and gives [`Results`], which serialise to `results.json` (`RESULTS.md` has the fields). Every
//! number comes from the rows of `/state` through [`fiatlux_rules`], never from the recorded result, so thresholds can
//! change without a new run. A bag that contradicts itself (checksums, header, rows, result: see [`Flaw`]) is not
//! scored. The folder of a run is graded as the run: each of its episodes counts, as its journals say.
//!
//! [`tables`] and [`report`] write results down. The same bags give the same bytes in all of them. [`compare()`] tests
//! two results against each other. This crate knows neither a network nor the simulator; `fiatlux_verify` runs an
//! episode again on a server.
//!
//! ```
//! use fiatlux_grading::{GradeOptions, grade, tables};
//!
//! # fn bags() -> std::path::PathBuf {
//! #     let folder = std::env::temp_dir().join(format!("fiatlux-grading-example-{}", std::process::id()));
//! #     std::fs::create_dir_all(&folder).unwrap();
//! #     std::fs::write(folder.join("notes.mcap"), "no bag").unwrap();
//! #     folder
//! # }
//! let folder = bags();
//! let results = grade(&[folder.clone()], &GradeOptions::default(), &|progress| {
//!     eprintln!("{} of {} bags", progress.bags_done, progress.bags);
//! })?;
//! println!("{}", tables::text(&results));
//! // This folder holds a file that is not a bag: it is listed with the reason, not scored.
//! assert_eq!((results.episodes.len(), results.excluded.len()), (0, 1));
//! assert!(results.has_data_loss());
//! # std::fs::remove_dir_all(folder).unwrap();
//! # Ok::<(), fiatlux_grading::ScoreError>(())
//! ```
#![allow(missing_docs)] // Used in this repository alone.
mod assemble;
mod bag;
mod claim;
mod compare;
mod conditions;
mod episode;
mod error;
mod find;
mod flaw;
mod grade;
mod options;
mod parts;
pub mod report;
mod request;
mod results;
mod rows;
mod run;
mod series;
pub mod tables;

pub use bag::check_bag;
pub use claim::false_claim;
pub use compare::{CompareError, ComparedRun, Comparison, Pairs, compare, compare_results};
pub use conditions::{Conditions, OBJECTS, is_of_senses};
pub use episode::{GradedEpisode, Grader, HeaderError};
pub use error::ScoreError;
pub use find::find_bags;
pub use flaw::{Difference, Flaw, first_difference};
pub use grade::{GradeProgress, grade, patience};
pub use options::GradeOptions;
pub use results::{
    EpisodeRow, ExcludedBag, Fault, Overall, PartResult, PartRow, RESULTS_VERSION, RateRow, Results, RunFailure,
    RunResult, Score, Scores, SeedRow, TaskResult, Versions,
};
pub use rows::{BagRows, RowsError, rows_of};
pub use series::{CriterionHeld, MAX_BUCKETS, Series};
