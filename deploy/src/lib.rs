//! The one-machine launcher: everything behind one command, clips of recorded episodes, and the benchmarks.

pub mod bench;
pub mod evaluate;
pub mod render;
