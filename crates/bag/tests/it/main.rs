//! Bags written, read, cut and damaged.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;
mod hostile;
mod ledger;
mod round_trip;
mod thin;
