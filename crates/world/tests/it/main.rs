//! What the rulebook takes from the world, and what a learner needs of it.
#![allow(clippy::unwrap_used, missing_docs)]

mod diverged;
mod learner;
mod rulebook;
mod strict;
