//! Arms that reach, on the engine, and fingers.
#![allow(clippy::unwrap_used, missing_docs)]

mod grip;
mod reach;
