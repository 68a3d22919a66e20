//! The connection to model servers: to doubles that use the real libraries, and to hostile servers.
#![allow(clippy::unwrap_used, missing_docs)]

mod doubles;
mod hostile;
