//! The world as the rulebook reads it and as a learner uses it, and stunts that its judges must tell from work.
#![allow(clippy::unwrap_used, missing_docs)]

mod diverged;
mod grip;
mod learner;
mod rest;
mod rulebook;
mod shaken;
mod strict;
mod stunts;
