//! The one-machine launcher: everything behind one command, and the benchmarks.

pub mod bench;
pub mod evaluate;
