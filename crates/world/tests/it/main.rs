//! What the rulebook takes from the world.
#![allow(clippy::unwrap_used, missing_docs)]

mod rulebook;
