//! Faults between the programs: processes that die, links that break, messages that are lost, and peers that mean
//! harm. Whatever happens, an episode has the rows that it has without it, or says that it does not.

mod deaths;
mod hostile;
mod links;
mod raw;
mod strangers;

/// An episode of 6,000 steps, some four seconds: long enough for something to happen to it.
const LONG: [&str; 4] = ["--policy", "zero", "--task", "S08"];
