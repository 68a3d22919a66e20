//! The tables, as a list of migrations: each is applied once, in order, and must never be changed afterwards.
//!
//! The SQL works in SQLite and PostgreSQL: `BIGINT` for numbers, `TEXT` for the rest, `$1` for parameters. Times are
//! milliseconds since 1970. Seeds are written in decimal digits, since they are unsigned 64-bit numbers.

use sqlx::{AssertSqlSafe, Row as _};

use super::database::{Database, DatabaseUrl};
use super::lock::PATIENCE;
use crate::StoreError;

/// The statements of each version, from version 1 on.
const MIGRATIONS: &[&[&str]] = &[FIRST, PICTURES, CLAIMS, REPLACES, LEASES, SUMMARIES];

const FIRST: &[&str] = &[
    "CREATE TABLE accounts (
        name TEXT PRIMARY KEY,
        created BIGINT NOT NULL,
        closed BIGINT,
        submissions_a_day BIGINT NOT NULL,
        max_bytes BIGINT NOT NULL
    )",
    "CREATE TABLE tokens (
        id TEXT PRIMARY KEY,
        account TEXT NOT NULL REFERENCES accounts (name),
        sha256 TEXT NOT NULL,
        created BIGINT NOT NULL,
        expires BIGINT NOT NULL,
        revoked BIGINT
    )",
    "CREATE TABLE audit (
        seq BIGINT PRIMARY KEY,
        at BIGINT NOT NULL,
        who TEXT NOT NULL,
        action TEXT NOT NULL,
        subject TEXT NOT NULL,
        detail TEXT NOT NULL
    )",
    "CREATE TABLE submissions (
        id TEXT PRIMARY KEY,
        account TEXT NOT NULL REFERENCES accounts (name),
        manifest TEXT NOT NULL,
        state TEXT NOT NULL,
        reason TEXT NOT NULL,
        badge TEXT NOT NULL,
        division TEXT,
        begun BIGINT NOT NULL,
        received BIGINT,
        bytes BIGINT NOT NULL,
        results TEXT
    )",
    "CREATE INDEX submissions_by_state ON submissions (state, received)",
    "CREATE INDEX submissions_by_account ON submissions (account, begun)",
    "CREATE TABLE files (
        submission TEXT NOT NULL REFERENCES submissions (id),
        place BIGINT NOT NULL,
        name TEXT NOT NULL,
        bytes BIGINT NOT NULL,
        sha256 TEXT NOT NULL,
        stored BIGINT NOT NULL,
        PRIMARY KEY (submission, place)
    )",
    "CREATE INDEX files_by_content ON files (sha256)",
    "CREATE TABLE episodes (
        submission TEXT NOT NULL REFERENCES submissions (id),
        task TEXT NOT NULL,
        seed TEXT NOT NULL,
        episode TEXT NOT NULL,
        place BIGINT NOT NULL,
        verdict TEXT NOT NULL,
        server TEXT NOT NULL,
        detail TEXT NOT NULL,
        PRIMARY KEY (submission, task, seed, episode)
    )",
    "CREATE INDEX episodes_by_verdict ON episodes (verdict, submission)",
];

/// Pictures of the best success of each subtask; `drawn` is the time at which a submission got its pictures.
const PICTURES: &[&str] = &[
    "CREATE TABLE pictures (
        submission TEXT NOT NULL REFERENCES submissions (id),
        task TEXT NOT NULL,
        seed TEXT NOT NULL,
        episode TEXT NOT NULL,
        still TEXT NOT NULL,
        clip TEXT NOT NULL,
        PRIMARY KEY (submission, task)
    )",
    "ALTER TABLE submissions ADD COLUMN drawn BIGINT",
];

/// `facts` are what grading established; badges, divisions and ranks follow from them when they are read. The columns `badge` and
/// `division` of before are no longer used. `indexed` is the time at which the rows of a submission were noted in `known_rows`, which
/// has each episode's rows once, by who had them first. `hosted_runs` has the registrations in the journals of the board's servers.
const CLAIMS: &[&str] = &[
    "ALTER TABLE submissions ADD COLUMN facts TEXT",
    "ALTER TABLE submissions ADD COLUMN indexed BIGINT",
    "CREATE TABLE known_rows (
        rows TEXT PRIMARY KEY,
        task TEXT NOT NULL,
        seed TEXT NOT NULL,
        submission TEXT NOT NULL,
        account TEXT NOT NULL,
        policy TEXT NOT NULL,
        senses TEXT NOT NULL,
        person BIGINT NOT NULL,
        at BIGINT NOT NULL
    )",
    "CREATE INDEX known_rows_by_submission ON known_rows (submission)",
    "CREATE TABLE hosted_runs (
        server TEXT NOT NULL,
        run TEXT NOT NULL,
        registration TEXT NOT NULL,
        PRIMARY KEY (server, run)
    )",
];

/// Verified submissions whose place a submission takes once it is verified, too: their ids, with spaces between them.
const REPLACES: &[&str] = &["ALTER TABLE submissions ADD COLUMN replaces TEXT"];

/// Claims on the episodes that wait. `queue` is the time at which the submission was received, `leased_until` the end of a claim or a
/// pause, 0 without one; `attempt` counts claims; `version` is that of the only servers that may claim it, empty for any. Of a refused
/// submission nothing waits: its episodes have the verdict `dropped`. `duties` are leases, too, of work that one scorer at a time does.
/// `counters` number rows, so that processes that write at once never choose the same number.
const LEASES: &[&str] = &[
    "ALTER TABLE episodes ADD COLUMN queue BIGINT NOT NULL DEFAULT 0",
    "ALTER TABLE episodes ADD COLUMN attempt BIGINT NOT NULL DEFAULT 0",
    "ALTER TABLE episodes ADD COLUMN leased_until BIGINT NOT NULL DEFAULT 0",
    "ALTER TABLE episodes ADD COLUMN refusals BIGINT NOT NULL DEFAULT 0",
    "ALTER TABLE episodes ADD COLUMN version TEXT NOT NULL DEFAULT ''",
    "UPDATE episodes SET queue = (SELECT COALESCE(s.received, s.begun) FROM submissions s WHERE s.id = episodes.submission)",
    "UPDATE episodes SET verdict = 'dropped' WHERE verdict = 'waiting' AND submission IN \
     (SELECT id FROM submissions WHERE state = 'refused')",
    "CREATE INDEX episodes_by_queue ON episodes (verdict, leased_until, version, queue, submission, task, seed, episode)",
    "CREATE TABLE duties (
        name TEXT PRIMARY KEY,
        term BIGINT NOT NULL,
        leased_until BIGINT NOT NULL
    )",
    "INSERT INTO duties (name, term, leased_until) VALUES ('grade', 0, 0), ('draw', 0, 0)",
    "CREATE TABLE counters (
        name TEXT PRIMARY KEY,
        value BIGINT NOT NULL
    )",
    "INSERT INTO counters (name, value) SELECT 'audit', COALESCE(MAX(seq), 0) FROM audit",
];

/// The part of results that the tables show: `results` is the digest of those that a summary was made of.
const SUMMARIES: &[&str] = &["CREATE TABLE summaries (
        submission TEXT PRIMARY KEY,
        results TEXT NOT NULL,
        layout BIGINT NOT NULL,
        summary TEXT NOT NULL
    )"];

/// The version of this program.
pub(super) const KNOWN: i64 = MIGRATIONS.len() as i64;

/// Opens a database with the tables of this version: makes those that are missing, and brings those of an older version to it.
pub(super) async fn open(url: &DatabaseUrl) -> Result<Database, StoreError> {
    let opened = Database::connect(url).await?;
    let _opening = opened.opening().await?;
    if version(&opened).await? < KNOWN {
        let in_use = || StoreError::InUse { store: url.to_string() };
        let _alone = opened.held(true, PATIENCE).await?.ok_or_else(in_use)?;
        migrate(&opened, KNOWN).await?;
    }
    Ok(opened)
}

/// The version of a database; 0 for a new one.
///
/// # Errors
/// As [`StoreError::Database`]; [`StoreError::Newer`]: this program is older than the database.
pub(super) async fn version(database: &Database) -> Result<i64, StoreError> {
    let failed = |action| StoreError::database(action);
    sqlx::query("CREATE TABLE IF NOT EXISTS schema_version (version BIGINT NOT NULL)")
        .execute(&database.writer)
        .await
        .map_err(failed("be opened"))?;
    let row = sqlx::query("SELECT COALESCE(MAX(version), 0) AS version FROM schema_version")
        .fetch_one(&database.writer)
        .await;
    let found: i64 = row.and_then(|row| row.try_get("version")).map_err(failed("tell its version"))?;
    if found > KNOWN { Err(StoreError::Newer { found, known: KNOWN }) } else { Ok(found) }
}

/// Brings a database to a version. Nothing else may use it.
pub(super) async fn migrate(database: &Database, to: i64) -> Result<(), StoreError> {
    let failed = |error| StoreError::database("be migrated")(error);
    let found = version(database).await?;
    let mut tx = database.write().await?;
    for (version, statements) in (1..=to).zip(MIGRATIONS).skip(usize::try_from(found).unwrap_or_default()) {
        for statement in *statements {
            sqlx::query(AssertSqlSafe(database.in_bytes(statement))).execute(&mut *tx).await.map_err(failed)?;
        }
        sqlx::query("INSERT INTO schema_version (version) VALUES ($1)")
            .bind(version)
            .execute(&mut *tx)
            .await
            .map_err(failed)?;
    }
    tx.commit().await.map_err(failed)
}
