//! Tests of foreign controllers: matching sessions, networks, refusals and tokens.
#![allow(clippy::unwrap_used)]

mod fits;
mod networks;
mod oracle;
mod refusals;
mod tokens;
