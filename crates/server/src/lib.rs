//! The simulation server and the recorder, on any carrier.
//!
//! - [`Server`] takes sessions and steps them on worker threads; with [`RecordsTo`] it says where records go.
//! - [`Recorder`] follows the sessions of servers and writes a bag for each episode.
//! - [`LocalServer`] is both in one process.
//!
//! The rules of a session are in `fiatlux_session`, what is simulated in `fiatlux_world`; this crate joins the two and carries
//! their messages.
#![allow(missing_docs)] // Used in this repository alone.
mod local;
#[cfg(test)]
mod rebuild_tests;
mod recorder;
mod server;

pub use local::{LocalBags, LocalServer};
pub use recorder::{BagEnd, BagReport, Naming, OnLoss, Recorder, RecorderError, RecorderOptions, RecordsFrom};
pub use server::{Counts, RecordError, RecordsTo, Server, ServerError, ServerOptions, SharedSeeds, simulate_thin_bags};
