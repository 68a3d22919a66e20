//! What the rulebook takes from the world, what a learner needs of it, and stunts that its judges must tell from work.
#![allow(clippy::unwrap_used, missing_docs)]

mod diverged;
mod learner;
mod rulebook;
mod strict;
mod stunts;
