//! The service over HTTP: its API, its pages, and its refusals.
#![allow(clippy::unwrap_used, missing_docs)]

mod api;
mod common;
mod hostile;
mod migrated;
mod mutated;
mod openapi;
mod pages;
#[path = "../stores/mod.rs"]
mod stores;
mod trust;

/// Guards every promise of the service where it keeps its data in PostgreSQL and a bucket, as here in a folder.
#[test]
#[ignore = "needs PostgreSQL: tests/run"]
fn the_service_on_postgres_and_a_bucket() {
    stores::on_postgres_and_a_bucket("the_service_on_postgres_and_a_bucket");
}
