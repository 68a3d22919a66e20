//! The rulebook in episodes made by hand.

#[path = "../common/mod.rs"]
mod common;

mod ends;
mod gates;
mod limits;
mod page;
mod progress;
mod rewards;
mod scores;
mod strict;
