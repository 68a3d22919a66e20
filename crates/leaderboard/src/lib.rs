//! The leaderboard: takes submissions over HTTP, grades and verifies their bags, and shows them.
//!
//! ```text
//! a run's folder --client--> incoming/ --checks--> blobs/ --grade--> Results --verify on sim-servers--> badge
//! Store                      what has come, what it amounts to, and the bags
//! api, pages                 JSON for programs, HTML for people
//! ```
//!
//! Grading never links the simulator; this crate does, through `fiatlux-replay`, and only to show pictures. What verifies
//! is a sim-server on the other side of a Zenoh link.

mod error;
mod pages;
mod service;
mod standings;
mod store;
mod submission;

pub use error::StoreError;
pub use service::{Service, router};
pub use store::Store;
pub use submission::{
    Badge, Division, Entry, Manifest, ManifestError, Observations, State, SubmissionId, Time, WordError,
};
