//! Runs over real processes: whatever dies on the way, every episode is played to the rows that it has without it, or is
//! named.

mod disk;
mod hangs;
mod kills;
mod lab;
mod loss;
mod refusals;
