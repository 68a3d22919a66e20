//! Tests of the batch.
#![allow(clippy::unwrap_used)]

mod cameras;
mod climbing;
mod common;
mod rates;
mod refused;
mod rulebook;
mod states;
mod threads;
mod walking;
mod watch;
