//! Grades bags: from recorded rows to scores, tables and a report.
//!
//! [`grade`] reads bags and gives [`Results`], which serialise to `results.json` (`RESULTS.md` has the fields). Every
//! number comes from the rows of `/state` through [`fiatlux_rules`], never from the recorded result, so thresholds can
//! change without a new run. The digest of the rows is compared with that of the result; a bag in which they differ is
//! not scored.
//!
//! [`tables`] and [`report`] write results down. The same bags give the same bytes in all of them.
//! [`verify()`] runs an episode again on a server. The scorer never links the simulator.
mod assemble;
mod bag;
mod conditions;
mod episode;
mod error;
mod find;
mod grade;
pub mod report;
mod results;
mod series;
pub mod tables;
mod verify;

pub use conditions::Conditions;
pub use episode::{Flaw, Graded, Grader, HeaderError};
pub use error::ScoreError;
pub use grade::{GradeOptions, Progress, grade};
pub use results::{
    EpisodeRow, ExcludedBag, Fault, Overall, RESULTS_VERSION, RateRow, Results, Score, SeedRow, TaskResult, Versions,
};
pub use series::{Held, MAX_BUCKETS, Series};
pub use verify::{Played, Verification, VerifyError, verify};
