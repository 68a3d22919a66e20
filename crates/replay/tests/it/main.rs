//! Replays of bags recorded here, of damaged bags, and their server.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;
mod documents;
mod hostile;
mod server;
