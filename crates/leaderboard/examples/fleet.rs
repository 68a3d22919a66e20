//! Measures several scorers on one store: processes that verify by sleeping, and processes that write to the audit log.
//!
//!     fleet verify FOLDER SCORERS SUBMISSIONS EPISODES SLEEP_MS
//!     fleet audit FOLDER WRITERS CHANGES
//!     fleet on-postgres verify|audit ...
//!
//! FOLDER must not exist; it is the store of the measurement. `on-postgres` has the database on a server of PostgreSQL that it starts. `verify` prints the time until all is verified, how many verifications
//! there were and how many of an episode at most. `audit` prints how many changes failed.
#![allow(clippy::unwrap_used)] // A failure is shown, and ends the example.

#[path = "../tests/stores/mod.rs"]
mod stores;
#[path = "../src/store/queue/waiting.rs"]
mod waiting;

use std::io::{Read as _, Write as _};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use fiatlux_leaderboard::{Jobs, Place, Quota, Service, ServiceOptions, Store, Verdict, Verifier, VerifyOutcome};
use sqlx::{AnyPool, AssertSqlSafe, Row as _};

#[derive(Debug)]
struct Sleeper {
    time: Duration,
    count: AtomicU64,
}

impl Verifier for Sleeper {
    fn name(&self) -> &str {
        "sleeper"
    }

    fn version(&self) -> Option<String> {
        None
    }

    fn verify(&self, _: &Path, _: &str, _: &mut u64, _: &AtomicBool) -> VerifyOutcome {
        self.count.fetch_add(1, Ordering::Relaxed);
        std::thread::sleep(self.time);
        VerifyOutcome::Decided(Verdict::Equal, String::new())
    }
}

#[tokio::main]
async fn main() {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let args: Vec<&str> = args.iter().map(String::as_str).collect();
    match args[..] {
        ["verify", folder, scorers, submissions, episodes, ms] => {
            measure_verify(folder, number(scorers), number(submissions), number(episodes), ms).await;
        }
        ["audit", folder, writers, changes] => measure_audit(folder, number(writers), changes).await,
        ["on-postgres", ref rest @ ..] => {
            let server = stores::Postgres::start_durable("fleet");
            let mut command = Command::new(std::env::current_exe().unwrap());
            assert!(command.args(rest).env(stores::SOCKET, server.socket()).status().unwrap().success());
        }
        ["--scorer", folder, ms] => scorer(folder, number(ms)).await,
        ["--writer", folder, name, changes] => writer(folder, name, number(changes)).await,
        _ => panic!("see the first lines of examples/fleet.rs"),
    }
}

fn number(text: &str) -> u64 {
    text.parse().unwrap()
}

async fn open(folder: &str) -> Store {
    let mut place = Place::folder(folder.as_ref());
    if let Some((database, _)) = stores::addresses(folder.as_ref()) {
        place.database = database.parse().unwrap();
    }
    Store::open_at(&place).await.unwrap()
}

fn start(args: &[&str]) -> Child {
    let mut command = Command::new(std::env::current_exe().unwrap());
    command.args(args).stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap()
}

/// Ends a process by the end of its input; returns the number that it printed.
fn end(mut child: Child) -> u64 {
    drop(child.stdin.take());
    let mut text = String::new();
    child.stdout.take().unwrap().read_to_string(&mut text).unwrap();
    assert!(child.wait().unwrap().success());
    number(text.trim())
}

async fn scorer(folder: &str, ms: u64) {
    let store = open(folder).await;
    let _joined = store.join().await.unwrap().unwrap();
    let sleeper = Arc::new(Sleeper { time: Duration::from_millis(ms), count: AtomicU64::new(0) });
    let service = Arc::new(Service::new(store, ServiceOptions::default()));
    let jobs = Jobs::verify(&service, vec![Arc::<Sleeper>::clone(&sleeper) as Arc<dyn Verifier>], 1).unwrap();
    tokio::task::spawn_blocking(|| {
        std::io::stdin().read_to_end(&mut Vec::new()).unwrap();
        jobs.stop();
    })
    .await
    .unwrap();
    println!("{}", sleeper.count.load(Ordering::Relaxed));
}

async fn measure_verify(folder: &str, scorers: u64, submissions: u64, episodes: u64, ms: &str) {
    drop(open(folder).await);
    let sqlite = || format!("sqlite://{folder}/leaderboard.sqlite");
    let url = stores::addresses(folder.as_ref()).map_or_else(sqlite, |(database, _)| database);
    let pool = AnyPool::connect(&url).await.unwrap();
    for statement in waiting::statements(submissions, episodes) {
        sqlx::query(AssertSqlSafe(statement)).execute(&pool).await.unwrap();
    }
    let start_time = Instant::now();
    let children: Vec<Child> = (0..scorers).map(|_| start(&["--scorer", folder, ms])).collect();
    loop {
        let row =
            sqlx::query("SELECT COUNT(*) FROM submissions WHERE state = 'graded'").fetch_one(&pool).await.unwrap();
        if row.get::<i64, _>(0) == 0 {
            break;
        }
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    let seconds = start_time.elapsed().as_secs_f64();
    let verifications: u64 = children.into_iter().map(end).sum();
    let row = sqlx::query("SELECT MAX(attempt), COUNT(*) FROM episodes WHERE verdict = 'equal'");
    let row = row.fetch_one(&pool).await.unwrap();
    let (attempts, verified): (i64, i64) = (row.get(0), row.get(1));
    println!(
        "{scorers} scorers: {verified} episodes in {seconds:.1} s, {verifications} verifications, at most {attempts} of one"
    );
}

async fn writer(folder: &str, name: &str, changes: u64) {
    let store = open(folder).await;
    let mut failed = 0;
    for number in 0..changes {
        if let Err(error) = store.make_account(&format!("{name}-{number}"), Quota::default()).await {
            failed += 1;
            drop(writeln!(std::io::stderr(), "{error}"));
        }
    }
    println!("{failed}");
}

async fn measure_audit(folder: &str, writers: u64, changes: &str) {
    let store = open(folder).await;
    let names: Vec<String> = (0..writers).map(|writer| format!("w{writer}")).collect();
    let children: Vec<Child> = names.iter().map(|name| start(&["--writer", folder, name, changes])).collect();
    let failed: u64 = children.into_iter().map(end).sum();
    let log = store.list_audit(10_000_000).await.unwrap();
    let is_whole = (1..).zip(&log).all(|(number, row)| row.seq == number);
    println!("{writers} writers: {failed} changes failed; {} lines, without a gap: {is_whole}", log.len());
}
