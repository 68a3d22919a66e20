//! The one-machine launcher: everything behind one command, clips of recorded episodes, the benchmarks, and the keys of an
//! installation.

pub mod bench;
pub mod evaluate;
pub mod keys;
mod part;
pub mod render;

pub use part::part_of;
