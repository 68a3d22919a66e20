//! Runs over real processes: whatever dies on the way, every episode is played to the rows that it has without it, or is
//! named.
#![allow(clippy::unwrap_used, missing_docs)]

#[path = "runs/disk.rs"]
mod disk;
#[path = "runs/hangs.rs"]
mod hangs;
#[path = "runs/kills.rs"]
mod kills;
#[path = "runs/lab.rs"]
mod lab;
#[path = "runs/loss.rs"]
mod loss;
