//! The stores of the tests: a folder with SQLite, or PostgreSQL with a bucket. [`on_postgres_and_a_bucket`] runs all tests of a program once
//! more, in a process of its own that gets the latter.
#![allow(dead_code, clippy::unwrap_used)] // Each program of tests uses a part.

mod postgres;
mod s3;

use std::path::Path;
use std::process::Command;

use sha2::{Digest as _, Sha256};

pub use postgres::Postgres;
pub use s3::Server;

/// The folder of PostgreSQL's socket, in a process that has a database and a bucket.
pub const SOCKET: &str = "FIATLUX_TEST_SOCKET";
const BUCKET: &str = "fiatlux-tests";

/// Addresses of database and files for the store of this folder; none for those in the folder itself. Creates the database.
pub fn addresses(folder: &Path) -> Option<(String, String)> {
    let socket = std::env::var(SOCKET).ok()?;
    let name = data_encoding::HEXLOWER.encode(&Sha256::digest(folder.as_os_str().as_encoded_bytes())[..12]);
    Some((postgres::database(&socket, &format!("t{name}")), format!("s3://{BUCKET}/tests/{name}")))
}

/// The address of a new database of a server.
pub fn database_of(server: &Postgres) -> String {
    postgres::database(server.socket().to_str().unwrap(), "own")
}

/// Runs all tests of this program that are named so on PostgreSQL and a bucket; fails as they do.
pub fn on_postgres_and_a_bucket(own: &str) {
    let (postgres, server) = (Postgres::start("suite"), Server::start(BUCKET));
    let mut tests = Command::new(std::env::current_exe().unwrap());
    tests.args(["--skip", own, "--test-threads", "4"]).env(SOCKET, postgres.socket()).envs(server.environment());
    let ended = tests.output().unwrap();
    let said = format!("{}{}", String::from_utf8_lossy(&ended.stdout), String::from_utf8_lossy(&ended.stderr));
    println!("{said}");
    assert!(ended.status.success());
    // A process that found no database would pass, too.
    assert!(postgres.databases() > 0, "{said}");
    println!("{} databases, {} requests to the bucket", postgres.databases(), server.requests());
}
