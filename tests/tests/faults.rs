//! What goes wrong between the programs: processes that die, links that break, messages that are lost, and peers that mean
//! harm. Whatever happens, an episode has the rows that it has without it, or says that it does not.
#![allow(clippy::unwrap_used, missing_docs)]

#[path = "faults/deaths.rs"]
mod deaths;
#[path = "faults/hostile.rs"]
mod hostile;
#[path = "faults/links.rs"]
mod links;
#[path = "faults/raw.rs"]
mod raw;
#[path = "faults/strangers.rs"]
mod strangers;

/// An episode of 6,000 steps, some four seconds: long enough for something to happen to it.
const LONG: [&str; 4] = ["--policy", "zero", "--task", "S08"];
