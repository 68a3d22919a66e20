//! The whole-body controller: what is shipped, how it stands, and what it refuses.
#![allow(clippy::unwrap_used, missing_docs)]

mod shipped;
mod standing;
mod swing;
