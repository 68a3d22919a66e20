//! The one-machine launcher: everything behind one command; today its benchmarks.

pub mod bench;
