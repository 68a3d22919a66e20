//! The service over HTTP: its API and its pages, and what it refuses.
#![allow(clippy::unwrap_used, missing_docs)]

mod api;
mod common;
mod hostile;
mod mutated;
mod openapi;
mod pages;
