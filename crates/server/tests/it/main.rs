//! A server over Zenoh: sessions and runs by clients of raw messages, and strangers on the same network.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;
mod runs;
mod service;
mod strangers;
mod strangers_floods;
mod strangers_mangled;
mod strangers_records;
