//! The G1 as data and as a model, and what its loader refuses.
#![allow(clippy::unwrap_used, missing_docs)]

mod g1;
mod g1_bare;
mod g1_dex3;
mod g1_inspire6;
mod model;
mod refused;
