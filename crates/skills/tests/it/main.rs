//! Arms that reach, on the engine.
#![allow(clippy::unwrap_used, missing_docs)]

mod reach;
