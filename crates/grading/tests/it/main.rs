//! Grades bags and runs on disk from end to end: good ones, changed ones and mutated ones.
#![allow(clippy::unwrap_used, missing_docs)]

mod bound;
#[path = "../common/mod.rs"]
mod common;
mod compare;
mod grade;
mod mutated;
mod relay;
mod run;
