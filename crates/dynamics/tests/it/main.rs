//! The engine against closed forms and a peer, and what it refuses.
#![allow(clippy::unwrap_used, missing_docs)]

mod closed_forms;
mod contact_points;
mod dense;
mod refused;
mod variation;
