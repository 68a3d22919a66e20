use std::collections::BTreeSet;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

#[path = "waiting.rs"]
mod waiting;

use sqlx::Connection as _;

use super::super::database::Database;
use super::super::lease::LEASE;
use super::super::{DatabaseUrl, Place, schema};
use super::*;

/// A folder that is removed when it is dropped.
pub(crate) struct Folder(pub PathBuf);

impl Folder {
    pub fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("fiatlux-queue-{name}-{}", std::process::id()));
        drop(std::fs::remove_dir_all(&path));
        Self(path)
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        drop(std::fs::remove_dir_all(&self.0));
    }
}

async fn run(store: &Store, statement: &str) {
    sqlx::query(AssertSqlSafe(statement.to_owned())).execute(&store.database.writer).await.unwrap();
}

/// Adds graded submissions 1 to `submissions` with `each` episodes that wait. The last one was received first.
pub(crate) async fn fill(store: &Store, submissions: u64, each: u64) {
    let mut tx = store.write().await.unwrap();
    for statement in waiting::statements(submissions, each) {
        sqlx::query(AssertSqlSafe(statement)).execute(&mut *tx).await.unwrap();
    }
    tx.commit().await.unwrap();
}

async fn filled(folder: &Folder, submissions: u64, each: u64) -> Store {
    let store = Store::of_test(&folder.0).await.unwrap();
    fill(&store, submissions, each).await;
    store
}

async fn next(store: &Store) -> EpisodeJob {
    store.claim("", LEASE).await.unwrap().unwrap()
}

/// Submission and seed.
fn place(job: &EpisodeJob) -> (u64, String) {
    (u64::from_str_radix(&job.submission.to_string(), 16).unwrap(), job.seed.clone())
}

/// Ends every claim and pause.
async fn end_claims(store: &Store) {
    run(store, "UPDATE episodes SET leased_until = 1 WHERE leased_until > 0").await;
}

/// Processor time of this process, ms.
fn processor_ms() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap();
    let fields: Vec<&str> = stat.rsplit(')').next().unwrap().split_whitespace().collect();
    [11, 12].iter().map(|index| fields[*index].parse::<f64>().unwrap() * 10.0).sum()
}

/// Guards that a claim does not look at all that waits.
#[tokio::test]
async fn a_claim_costs_the_same_however_much_waits() {
    let mut steps = Vec::new();
    for submissions in [20, 2_000] {
        let folder = Folder::new(&format!("cost-{submissions}"));
        let store = Store::open(&folder.0).await.unwrap();
        fill(&store, submissions, 48).await;
        for _ in 0..3 {
            next(&store).await;
        }
        end_claims(&store).await;
        next(&store).await;
        // SQLite counts the steps of a connection of its own.
        let options = sqlx::sqlite::SqliteConnectOptions::new().filename(folder.0.join("leaderboard.sqlite"));
        let mut connection = sqlx::SqliteConnection::connect_with(&options).await.unwrap();
        let count = Arc::new(AtomicU64::new(0));
        let counted = Arc::clone(&count);
        connection.lock_handle().await.unwrap().set_progress_handler(1, move || {
            counted.fetch_add(1, Ordering::Relaxed);
            true
        });
        let claim = sqlx::query(AssertSqlSafe(store.database.passing_by(CLAIM))).bind("").bind(1_i64);
        assert!(claim.fetch_optional(&mut connection).await.unwrap().is_some());
        steps.push(count.load(Ordering::Relaxed));
    }
    assert!(steps[0] > 0 && steps[1] <= steps[0] + 5, "{steps:?}");
    // A clock's say, and a minute of filling: `.ci/nightly` has it.
    if std::env::var_os("FIATLUX_ALL_ROOMS").is_some() {
        let folder = Folder::new("cost-million");
        let store = Store::open(&folder.0).await.unwrap();
        fill(&store, MILLION, 48).await;
        claims_take_2_ms(&store, processor_ms).await;
    }
}

/// The same on PostgreSQL, which chooses by itself how it comes to a row: a claim reads as few pages, before and after it has counted its
/// rows, and in a million takes no more time of all its processes and of this one.
#[tokio::test]
#[ignore = "needs PostgreSQL: tests/run"]
async fn a_claim_costs_the_same_on_postgres() {
    let is_nightly = std::env::var_os("FIATLUX_ALL_ROOMS").is_some();
    let postgres = crate::stores::Postgres::start("claims");
    let folder = Folder::new("cost-postgres");
    let database = crate::stores::database_of(&postgres).parse().unwrap();
    let store = Store::open_at(&Place { database, ..Place::folder(&folder.0) }).await.unwrap();
    fill(&store, if is_nightly { MILLION } else { 2_000 }, 48).await;
    for _ in 0..2 {
        for statement in [one_of(ENDED), one_of(FAR), one_of(WANTING), store.database.passing_by(CLAIM)] {
            let pages = pages_of(&store, &statement).await;
            assert!(pages <= 200, "{pages} pages: {statement}");
        }
        if is_nightly {
            claims_take_2_ms(&store, || processor_ms() + postgres.processor_ms()).await;
        }
        run(&store, "ANALYZE").await;
    }
}

/// Number of submissions of 48 that a million episodes are.
const MILLION: u64 = 1_000_000 / 48 + 1;

async fn claims_take_2_ms(store: &Store, processor_ms: impl Fn() -> f64) {
    let start = processor_ms();
    for _ in 0..500 {
        next(store).await;
    }
    let each = (processor_ms() - start) / 500.0;
    println!("{each:.3} ms of processor time a claim with 1,000,000 episodes");
    assert!(each <= 2.0, "{each} ms");
}

/// Number of pages that PostgreSQL reads for a statement of a claim, which it has prepared and plans without the values.
async fn pages_of(store: &Store, statement: &str) -> u64 {
    let (types, values) = match statement {
        claim if claim.contains("$2") => ("(text, bigint)", "('', 1)"),
        look if look.contains("$1") => ("(bigint)", "(1)"),
        _ => ("", ""),
    };
    let mut connection = store.database.pool.acquire().await.unwrap();
    for first in ["SET plan_cache_mode = force_generic_plan", &format!("PREPARE counted{types} AS {statement}")] {
        sqlx::raw_sql(AssertSqlSafe(first.to_owned())).execute(&mut *connection).await.unwrap();
    }
    let explain = format!("EXPLAIN (ANALYZE, BUFFERS) EXECUTE counted{values}");
    let plan = sqlx::raw_sql(AssertSqlSafe(explain)).fetch_all(&mut *connection).await.unwrap();
    connection.close().await.unwrap();
    let lines = plan.iter().map(|row| row.try_get::<String, _>(0).unwrap()).collect::<Vec<_>>();
    // The first line of them is of the whole statement.
    let buffers = lines.iter().find_map(|line| line.trim().strip_prefix("Buffers: shared ")).unwrap();
    let count = |kind: &str| buffers.split(' ').find_map(|part| part.strip_prefix(kind)?.parse::<u64>().ok());
    count("hit=").unwrap_or(0) + count("read=").unwrap_or(0)
}

/// Guards claims of two processes: each has connections of its own.
#[tokio::test]
async fn two_claimers_never_get_the_same_episode() {
    let folder = Folder::new("two");
    let one = filled(&folder, 10, 4).await;
    let other = Store::of_test(&folder.0).await.unwrap();
    let all = async |store: &Store| {
        let mut found = Vec::new();
        while let Some(job) = store.claim("", LEASE).await.unwrap() {
            found.push(place(&job));
        }
        found
    };
    let (first, second) = tokio::join!(all(&one), all(&other));
    let whole: BTreeSet<_> = first.iter().chain(&second).collect();
    assert_eq!((first.len() + second.len(), whole.len()), (40, 40));
}

/// Guards that what a killed worker had claimed comes first, and that it has no say if it was not killed.
#[tokio::test]
async fn an_ended_claim_is_taken_again_before_others() {
    let folder = Folder::new("ended");
    let store = filled(&folder, 2, 2).await;
    let late = next(&store).await;
    assert_eq!((place(&late), late.attempt), ((2, "1".into()), 1));
    let held = next(&store).await;
    assert_eq!(place(&held), (2, "2".into()));
    end_claims(&store).await;
    assert!(store.renew(&held, LEASE).await.unwrap(), "nobody has taken it");
    let again = next(&store).await;
    assert_eq!((place(&again), again.attempt), (place(&late), 2));
    assert!(!store.renew(&late, LEASE).await.unwrap());
    store.release(&late, Duration::ZERO, &Return::Refused).await.unwrap();
    assert!(!store.set_verdict(&late, Verdict::Differs, "late", "").await.unwrap());
    assert_eq!(place(&next(&store).await), (1, "1".into()), "the second claim and the renewed one hold");
    assert!(store.set_verdict(&again, Verdict::Equal, "again", "").await.unwrap());
    assert!(!store.set_verdict(&again, Verdict::Differs, "again", "").await.unwrap(), "a verdict stays");
    assert!(store.set_verdict(&held, Verdict::Equal, "held", "").await.unwrap());
    let state = store.states().await.unwrap();
    assert_eq!(
        state.iter().map(|count| (&*count.kind, count.count)).collect::<Vec<_>>(),
        [("graded", 1), ("verified", 1)]
    );
}

/// Guards that refusals and pauses outlive the process, and that a clock that ran ahead holds nothing up.
#[tokio::test]
async fn pauses_and_refusals_are_kept() {
    let folder = Folder::new("pauses");
    let store = filled(&folder, 1, 2).await;
    let first = next(&store).await;
    store.release(&first, Duration::from_secs(600), &Return::Refused).await.unwrap();
    drop(store);
    let store = Store::of_test(&folder.0).await.unwrap();
    let second = next(&store).await;
    assert_eq!((&*second.seed, second.refusals), ("2", 0));
    assert_eq!(store.claim("", LEASE).await.unwrap(), None);
    store.release(&second, Duration::ZERO, &Return::Unplayed).await.unwrap();
    assert_eq!(next(&store).await.refusals, 0);
    run(&store, "UPDATE episodes SET leased_until = leased_until + 90000000 WHERE seed = '1'").await;
    let first = next(&store).await;
    assert_eq!((&*first.seed, first.refusals), ("1", 1));
}

/// Guards that nothing of a refused submission is verified, or stays at the head of the queue.
#[tokio::test]
async fn nothing_of_a_refused_submission_waits() {
    let folder = Folder::new("refused");
    let store = filled(&folder, 2, 2).await;
    let held = next(&store).await;
    store.refuse(held.submission, "service", "a reason").await.unwrap();
    assert!(!store.set_verdict(&held, Verdict::Equal, "", "").await.unwrap());
    assert_eq!(place(&next(&store).await), (1, "1".into()));
    let verdicts = store.verdicts().await.unwrap();
    assert_eq!(
        verdicts.iter().map(|count| (&*count.kind, count.count)).collect::<Vec<_>>(),
        [("dropped", 2), ("waiting", 2)]
    );
}

/// Guards that a server of another version costs a good run one try, and no longer holds up one of its own.
#[tokio::test]
async fn an_episode_waits_for_a_server_of_its_version() {
    let folder = Folder::new("versions");
    let store = filled(&folder, 2, 2).await;
    for _ in 0..2 {
        let job = store.claim("0.8.0", LEASE).await.unwrap().unwrap();
        assert_eq!(place(&job).0, 2);
        assert!(!store.wants_version().await.unwrap() || place(&job).1 == "2");
        store.release(&job, Duration::ZERO, &Return::OtherVersion("0.7.0".into())).await.unwrap();
    }
    assert!(store.wants_version().await.unwrap());
    let other = store.claim("0.8.0", LEASE).await.unwrap().unwrap();
    assert_eq!(place(&other), (1, "1".into()), "later ones are not held up");
    store.release(&other, Duration::ZERO, &Return::Unplayed).await.unwrap();
    let own = store.claim("0.7.0", LEASE).await.unwrap().unwrap();
    assert_eq!((place(&own), own.refusals), ((2, "1".into()), 0), "in its old place, and refused by nobody");
    // A pause of another kind leaves the version alone.
    store.release(&own, Duration::ZERO, &Return::Unplayed).await.unwrap();
    assert_eq!(place(&next(&store).await).0, 1);
}

/// Guards the claims of others: only a scorer that is alone ends what killed ones have left. A refusal's pause stays.
#[tokio::test]
async fn the_first_scorer_ends_the_claims_of_killed_ones() {
    let folder = Folder::new("joined");
    let store = filled(&folder, 1, 3).await;
    let refused = next(&store).await;
    store.release(&refused, Duration::from_secs(180), &Return::Refused).await.unwrap();
    let killed = next(&store).await;
    let _first = store.join().await.unwrap().unwrap();
    let again = next(&store).await;
    assert_eq!((place(&again), again.attempt), (place(&killed), 2));
    let _second = store.join().await.unwrap().unwrap();
    assert_eq!(place(&next(&store).await).1, "3", "the claim of the first scorer holds");
    assert_eq!(store.claim("", LEASE).await.unwrap(), None, "the refused one pauses");
}

/// Guards the numbers of the audit log against scorers that write at once: each has a connection of its own.
#[tokio::test]
async fn writers_at_once_lose_no_line_of_the_audit_log() {
    let changes = if std::env::var_os("FIATLUX_ALL_ROOMS").is_some() { 1_000 } else { 25 };
    let folder = Folder::new("audit");
    let mut stores = Vec::new();
    for _ in 0..4 {
        stores.push(Store::of_test(&folder.0).await.unwrap());
    }
    let writers = stores.iter().enumerate().map(|(writer, store)| async move {
        for number in 0..changes {
            store.make_account(&format!("a{writer}-{number}"), crate::Quota::default()).await.unwrap();
        }
    });
    let mut writers = writers.collect::<Vec<_>>().into_iter();
    let mut one = || writers.next().unwrap();
    tokio::join!(one(), one(), one(), one());
    let log = stores[0].list_audit(1_000_000).await.unwrap();
    assert!(log.iter().map(|row| row.seq).eq(1..=4 * changes), "{} lines", log.len());
}

/// Guards that a database of version 4, of before the claims, keeps what waits, in the order in which it was received.
#[tokio::test]
async fn an_old_queue_keeps_its_order() {
    let folder = Folder::new("old");
    std::fs::create_dir_all(&folder.0).unwrap();
    let old = Database::connect(&DatabaseUrl::in_folder(&folder.0)).await.unwrap();
    schema::migrate(&old, 4).await.unwrap();
    for statement in [
        "INSERT INTO accounts (name, created, submissions_a_day, max_bytes) VALUES ('lab', 0, 1, 1)",
        "INSERT INTO audit (seq, at, who, action, subject, detail) VALUES (7, 0, 'admin', 'account made', 'lab', '')",
        "INSERT INTO submissions (id, account, manifest, state, reason, badge, begun, received, bytes, facts) VALUES \
         ('0000000000000001', 'lab', '{}', 'graded', '', '', 0, 30, 0, '{}'), \
         ('0000000000000002', 'lab', '{}', 'refused', '', '', 0, 20, 0, '{}'), \
         ('0000000000000003', 'lab', '{}', 'graded', '', '', 0, 10, 0, '{}')",
        "INSERT INTO files (submission, place, name, bytes, sha256, stored) \
         SELECT id, 0, 'a.mcap', 1, printf('%064x', received), 1 FROM submissions",
        "INSERT INTO episodes (submission, task, seed, episode, place, verdict, server, detail) \
         SELECT id, 'S01', '1', '0', 0, 'waiting', '', '' FROM submissions",
    ] {
        sqlx::query(statement).execute(&old.writer).await.unwrap_or_else(|error| panic!("{statement}: {error}"));
    }
    old.close().await;
    let store = Store::open(&folder.0).await.unwrap();
    assert_eq!((place(&next(&store).await).0, place(&next(&store).await).0), (3, 1));
    assert_eq!(store.claim("", LEASE).await.unwrap(), None, "nothing of a refused submission waits");
    store.make_account("two", crate::Quota::default()).await.unwrap();
    let log = store.list_audit(10).await.unwrap();
    assert_eq!(log.iter().map(|row| row.seq).collect::<Vec<_>>(), [7, 8]);
}
