//! Replays of bags that are recorded here, of damaged ones, and their server.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;
mod documents;
mod hostile;
mod server;
