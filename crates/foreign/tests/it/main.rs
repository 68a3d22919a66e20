//! Controllers of others.
#![allow(clippy::unwrap_used)]

mod fits;
mod networks;
mod oracle;
mod refusals;
mod tokens;
