//! The leaderboard: accepts submissions over HTTP, grades and verifies their bags, and shows them.
//!
//! ```text
//! a run's folder --client--> incoming/ --checks--> blobs/ --grade--> Results --verify on sim-servers--> badge
//! Store                      submissions, their results and their bags
//! api, pages                 JSON for programs, HTML for people
//! ```
//!
//! Grading never links the simulator; this crate does, through `fiatlux-replay`, and only to show pictures. Verifying is
//! the work of a sim-server on the other side of a Zenoh link.
#![allow(missing_docs)] // Used in this repository alone.

mod accounts;
mod api;
mod claims;
mod client;
mod counts;
mod error;
mod forwarded;
mod jobs;
mod metrics;
mod paced;
mod pages;
mod paper;
mod routes;
mod serve;
mod service;
mod standings;
mod store;
#[cfg(test)]
#[path = "../tests/stores/mod.rs"]
mod stores;
mod submission;
mod visitors;

pub use accounts::{AccountError, MAX_DAYS, Quota};
pub use client::{Submit, SubmitError, SubmitProgress, Submitted, Upload};
pub use error::StoreError;
pub use forwarded::{Proxies, ProxyError};
pub use jobs::{Jobs, ServerGroup, ServerVerifier, Verifier, VerifierGroup, Verifiers, VerifyOutcome};
pub use routes::router;
pub use serve::{listen, serve, serve_metrics};
pub use service::{Pace, Service, ServiceOptions};
pub use store::{
    Account, AuditRow, DatabaseUrl, FilesUrl, Joined, KnownBags, Place, Store, ThinnedBags, TokenRow, Verdict,
};
pub use submission::{
    Badge, Claim, Claims, Division, Entry, Kind, Limits, Manifest, ManifestError, Observations, Proof, Stage,
    SubmissionId, Time, WordError,
};

#[cfg(test)]
mod tests {
    /// Guards the store where it is PostgreSQL, as here SQLite.
    #[test]
    #[ignore = "needs PostgreSQL: tests/run"]
    fn the_store_on_postgres() {
        crate::stores::on_postgres_and_a_bucket("the_store_on_postgres");
    }
}
