//! The world against closed forms and MuJoCo, the programs together as processes, and the pages.
#![allow(clippy::unwrap_used, missing_docs)]

mod access;
mod bridges;
mod cluster;
mod determinism;
mod end_to_end;
mod faults;
mod leaderboard;
mod links;
mod physics;
mod pins;
mod programs;
mod python_client;
mod readme;
mod runs;
#[path = "../../../crates/leaderboard/tests/stores/mod.rs"]
mod stores;
mod teleop;
mod thin;
