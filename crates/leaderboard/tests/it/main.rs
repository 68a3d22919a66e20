//! The service over HTTP: its API, its pages, and its refusals.
#![allow(clippy::unwrap_used, missing_docs)]

mod api;
mod common;
mod hostile;
mod migrated;
mod mutated;
mod openapi;
mod pages;
mod trust;
