//! Submissions and their files.

use sqlx::Row as _;

use super::accounts::audit;
use super::database::{Row, Tx};
use super::facts::{RunsInputs, facts_in, forget_rows};
use super::{Account, Digest, Store, Term, moment, now_ms};
use crate::claims::{Facts, Progress, decide, tries_of};
use crate::submission::{FileSpec, word_of};
use crate::{Entry, Manifest, Stage, StoreError, SubmissionId};

/// Maximum number of submissions of an account that may wait for files at once.
const MAX_OPEN: i64 = 8;
/// Period of the daily limit, ms.
const DAY_MS: i64 = 24 * 3600 * 1000;

const ASK: &str = "be asked for a submission";
const CHANGE: &str = "change a submission";

/// A submission that is being announced, before its first file.
#[derive(Debug)]
pub(crate) struct Draft {
    pub id: SubmissionId,
    pub manifest: Manifest,
    pub files: Vec<FileSpec>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum BeginOutcome {
    New,
    Known,
    /// The account has begun this many within 24 hours, which is its limit.
    TooManyToday(i64),
    /// The account has this many submissions that wait for files, which is the limit.
    TooManyOpen(i64),
    /// It would exceed this many bytes, the account's limit for all its submissions.
    TooManyBytes(i64),
}

/// A file of a submission, as its submitter may see it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FileRow {
    /// Its index in the submission's list of files.
    pub place: i64,
    /// Checked to be no path.
    pub name: String,
    pub bytes: i64,
    /// Announced SHA-256 of its content, hexadecimal.
    pub sha256: String,
    /// The whole file has arrived, with this digest.
    pub stored: bool,
}

#[derive(Debug, Clone)]
pub(crate) struct StoredFile {
    pub bytes: u64,
    pub digest: Digest,
    pub stored: bool,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Count {
    /// A state or a verdict.
    pub kind: String,
    pub count: i64,
}

/// Selects the columns of an entry; the argument selects the submissions.
macro_rules! entries {
    ($rest:literal) => {
        concat!(
            "SELECT s.*, \
             (SELECT COUNT(*) FROM episodes e WHERE e.submission = s.id AND e.verdict = 'equal') AS done, \
             (SELECT COUNT(*) FROM episodes e WHERE e.submission = s.id AND e.verdict = 'refused') AS refused, \
             (SELECT COUNT(*) FROM episodes e WHERE e.submission = s.id) AS whole \
             FROM submissions s ",
            $rest
        )
    };
}

impl Store {
    pub(super) async fn listed(&self) -> Result<Vec<Entry>, StoreError> {
        let rows = sqlx::query(entries!("WHERE s.state IN ('graded', 'verified') ORDER BY s.received, s.id"))
            .fetch_all(&self.database.pool)
            .await;
        let runs = self.runs().await?;
        rows.map_err(StoreError::database(ASK))?.iter().map(|row| entry_of(row, &runs)).collect()
    }

    /// Every submission of an account, or of all, in any state, oldest first.
    pub(crate) async fn every(&self, account: Option<&str>) -> Result<Vec<Entry>, StoreError> {
        let rows = sqlx::query(entries!("WHERE $1 IS NULL OR s.account = $1 ORDER BY s.begun, s.id"))
            .bind(account)
            .fetch_all(&self.database.pool)
            .await;
        let runs = self.runs().await?;
        rows.map_err(StoreError::database(ASK))?.iter().map(|row| entry_of(row, &runs)).collect()
    }

    pub(super) async fn one(&self, id: SubmissionId) -> Result<Option<Entry>, StoreError> {
        let row =
            sqlx::query(entries!("WHERE s.id = $1")).bind(id.to_string()).fetch_optional(&self.database.pool).await;
        let runs = self.runs().await?;
        row.map_err(StoreError::database(ASK))?.map(|row| entry_of(&row, &runs)).transpose()
    }

    pub(super) async fn results_digest(&self, id: SubmissionId) -> Result<Option<Digest>, StoreError> {
        let row = sqlx::query("SELECT results FROM submissions WHERE id = $1")
            .bind(id.to_string())
            .fetch_optional(&self.database.pool)
            .await
            .map_err(StoreError::database(ASK))?;
        let Some(row) = row else { return Ok(None) };
        let text: Option<String> = row.try_get("results").map_err(StoreError::database(ASK))?;
        text.map(|text| digest_of(&text)).transpose()
    }

    pub(super) async fn bag_digest(
        &self,
        id: SubmissionId,
        task: &str,
        seed: u64,
        episode: u64,
    ) -> Result<Option<Digest>, StoreError> {
        let row = sqlx::query(
            "SELECT f.sha256 FROM episodes e JOIN files f ON f.submission = e.submission AND f.place = e.place \
             WHERE e.submission = $1 AND e.task = $2 AND e.seed = $3 AND e.episode = $4",
        )
        .bind(id.to_string())
        .bind(task)
        .bind(seed.to_string())
        .bind(episode.to_string())
        .fetch_optional(&self.database.pool)
        .await
        .map_err(StoreError::database(ASK))?;
        let text = row.map(|row| row.try_get::<String, _>("sha256")).transpose();
        text.map_err(StoreError::database(ASK))?.map(|text| digest_of(&text)).transpose()
    }

    /// Begins a submission if the limits of its account allow it. Beginning the same draft again changes nothing.
    pub(crate) async fn begin(&self, account: &Account, draft: &Draft) -> Result<BeginOutcome, StoreError> {
        let failed = |error| StoreError::database("take a submission")(error);
        let bytes: i64 = draft.files.iter().map(|file| file.bytes as i64).sum();
        let (id, now) = (draft.id.to_string(), now_ms());
        let mut tx = self.write().await?;
        let row = sqlx::query(
            "SELECT (SELECT COUNT(*) FROM submissions WHERE id = $1) AS known, \
             (SELECT COUNT(*) FROM submissions WHERE account = $2 AND begun > $3 AND begun <= $4) AS today, \
             (SELECT COUNT(*) FROM submissions WHERE account = $2 AND state = 'uploading') AS open, \
             (SELECT CAST(COALESCE(SUM(bytes), 0) AS BIGINT) FROM submissions WHERE account = $2) AS bytes",
        )
        .bind(&id)
        .bind(&account.name)
        .bind(now - DAY_MS)
        // What a clock that ran ahead has dated later than now belongs to no day.
        .bind(now)
        .fetch_one(&mut *tx)
        .await
        .map_err(failed)?;
        let count = |column| row.try_get::<i64, _>(column).map_err(failed);
        if count("known")? > 0 {
            return Ok(BeginOutcome::Known);
        }
        if count("today")? >= account.submissions_a_day {
            return Ok(BeginOutcome::TooManyToday(account.submissions_a_day));
        }
        if count("open")? >= MAX_OPEN {
            return Ok(BeginOutcome::TooManyOpen(MAX_OPEN));
        }
        if count("bytes")?.saturating_add(bytes) > account.max_bytes {
            return Ok(BeginOutcome::TooManyBytes(account.max_bytes));
        }
        let manifest = serde_json::to_string(&draft.manifest)
            .map_err(|error| StoreError::corrupt("the manifest of a new submission", error))?;
        sqlx::query(
            "INSERT INTO submissions (id, account, manifest, state, reason, badge, begun, bytes) \
             VALUES ($1, $2, $3, 'uploading', '', 'self_reported', $4, $5)",
        )
        .bind(&id)
        .bind(&account.name)
        .bind(manifest)
        .bind(now)
        .bind(bytes)
        .execute(&mut *tx)
        .await
        .map_err(failed)?;
        for (place, file) in (0_i64..).zip(&draft.files) {
            sqlx::query(
                "INSERT INTO files (submission, place, name, bytes, sha256, stored) VALUES ($1, $2, $3, $4, $5, 0)",
            )
            .bind(&id)
            .bind(place)
            .bind(&file.name)
            .bind(file.bytes as i64)
            .bind(file.sha256.as_str())
            .execute(&mut *tx)
            .await
            .map_err(failed)?;
        }
        let files = format!("{} files, {bytes} bytes", draft.files.len());
        audit(&mut tx, &account.name, "submission begun", &id, &files).await?;
        tx.commit().await.map_err(failed)?;
        Ok(BeginOutcome::New)
    }

    /// The files of a submission, by place.
    pub(crate) async fn files(&self, id: SubmissionId) -> Result<Vec<FileRow>, StoreError> {
        let failed = |error| StoreError::database(ASK)(error);
        let rows = sqlx::query("SELECT * FROM files WHERE submission = $1 ORDER BY place")
            .bind(id.to_string())
            .fetch_all(&self.database.pool)
            .await
            .map_err(failed)?;
        let row_of = |row: &Row| {
            Ok(FileRow {
                place: row.try_get("place")?,
                name: row.try_get("name")?,
                bytes: row.try_get("bytes")?,
                sha256: row.try_get("sha256")?,
                stored: row.try_get::<i64, _>("stored")? != 0,
            })
        };
        rows.iter().map(row_of).collect::<Result<_, _>>().map_err(failed)
    }

    pub(crate) async fn file(&self, id: SubmissionId, place: u32) -> Result<Option<StoredFile>, StoreError> {
        let failed = |error| StoreError::database(ASK)(error);
        let row = sqlx::query("SELECT bytes, sha256, stored FROM files WHERE submission = $1 AND place = $2")
            .bind(id.to_string())
            .bind(i64::from(place))
            .fetch_optional(&self.database.pool)
            .await
            .map_err(failed)?;
        let Some(row) = row else { return Ok(None) };
        let bytes = row.try_get::<i64, _>("bytes").map_err(failed)? as u64;
        let digest = digest_of(&row.try_get::<String, _>("sha256").map_err(failed)?)?;
        Ok(Some(StoredFile { bytes, digest, stored: row.try_get::<i64, _>("stored").map_err(failed)? != 0 }))
    }

    pub(crate) async fn set_stored(&self, id: SubmissionId, place: u32) -> Result<(), StoreError> {
        let mut tx = self.write().await?;
        sqlx::query("UPDATE files SET stored = 1 WHERE submission = $1 AND place = $2")
            .bind(id.to_string())
            .bind(i64::from(place))
            .execute(&mut *tx)
            .await
            .map_err(StoreError::database(CHANGE))?;
        tx.commit().await.map_err(StoreError::database(CHANGE))
    }

    /// Accepts a submission if all its files are stored, so that it will be graded; returns the number of missing files.
    pub(crate) async fn receive(&self, id: SubmissionId, account: &str) -> Result<u64, StoreError> {
        let failed = |error| StoreError::database(CHANGE)(error);
        let mut tx = self.write().await?;
        let row = sqlx::query("SELECT COUNT(*) AS missing FROM files WHERE submission = $1 AND stored = 0")
            .bind(id.to_string())
            .fetch_one(&mut *tx)
            .await
            .map_err(failed)?;
        let missing: i64 = row.try_get("missing").map_err(failed)?;
        if missing > 0 {
            return Ok(missing as u64);
        }
        let done = sqlx::query(
            "UPDATE submissions SET state = 'received', received = $2 WHERE id = $1 AND state = 'uploading'",
        )
        .bind(id.to_string())
        .bind(now_ms())
        .execute(&mut *tx)
        .await
        .map_err(failed)?;
        if done.rows_affected() == 1 {
            audit(&mut tx, account, "submission received", &id.to_string(), "").await?;
        }
        tx.commit().await.map_err(failed)?;
        Ok(0)
    }

    /// Refuses a submission for good, for a reason that its submitter can read.
    pub(crate) async fn refuse(&self, id: SubmissionId, who: &str, reason: &str) -> Result<(), StoreError> {
        let mut tx = self.write().await?;
        refuse(&mut tx, id, who, reason).await?;
        tx.commit().await.map_err(StoreError::database(CHANGE))
    }

    /// As [`Store::refuse`], by the scorer that grades; does nothing if another one grades now.
    pub(crate) async fn refuse_on(&self, term: Term, id: SubmissionId, reason: &str) -> Result<(), StoreError> {
        let Some(mut tx) = self.write_on(term).await? else { return Ok(()) };
        refuse(&mut tx, id, "service", reason).await?;
        tx.commit().await.map_err(StoreError::database(CHANGE))
    }

    /// Removes a submission and the files that only it uses; returns `false` if there is none.
    pub(crate) async fn remove(&self, id: SubmissionId, who: &str) -> Result<bool, StoreError> {
        let failed = |error| StoreError::database("remove a submission")(error);
        let mut tx = self.write().await?;
        let alone = sqlx::query(
            "SELECT DISTINCT f.sha256 FROM files f WHERE f.submission = $1 AND NOT EXISTS \
             (SELECT 1 FROM files o WHERE o.sha256 = f.sha256 AND o.submission <> $1) ORDER BY f.sha256",
        )
        .bind(id.to_string())
        .fetch_all(&mut *tx)
        .await
        .map_err(failed)?;
        let results = sqlx::query(
            "SELECT s.results FROM submissions s WHERE s.id = $1 AND s.results IS NOT NULL AND NOT EXISTS \
             (SELECT 1 FROM submissions o WHERE o.results = s.results AND o.id <> $1)",
        )
        .bind(id.to_string())
        .fetch_optional(&mut *tx)
        .await
        .map_err(failed)?;
        let pictures = sqlx::query(
            "SELECT still FROM pictures WHERE submission = $1 UNION SELECT clip FROM pictures WHERE submission = $1 \
             EXCEPT SELECT still FROM pictures WHERE submission <> $1 EXCEPT SELECT clip FROM pictures WHERE submission <> $1",
        )
        .bind(id.to_string())
        .fetch_all(&mut *tx)
        .await
        .map_err(failed)?;
        for statement in [
            "DELETE FROM pictures WHERE submission = $1",
            "DELETE FROM summaries WHERE submission = $1",
            "DELETE FROM episodes WHERE submission = $1",
            "DELETE FROM files WHERE submission = $1",
            "DELETE FROM submissions WHERE id = $1",
        ] {
            let done = sqlx::query(statement).bind(id.to_string()).execute(&mut *tx).await.map_err(failed)?;
            if statement.contains("submissions") && done.rows_affected() == 0 {
                return Ok(false);
            }
        }
        forget_rows(&mut tx, &id.to_string()).await?;
        audit(&mut tx, who, "submission removed", &id.to_string(), "").await?;
        // Files are removed last, before the commit, so that nobody can begin a submission that needs them: an extra
        // file does no harm, a missing one does.
        for row in alone.iter().chain(&results).chain(&pictures) {
            let digest = digest_of(&row.try_get::<String, _>(0).map_err(failed)?)?;
            self.blobs.remove(&digest).await?;
        }
        tx.commit().await.map_err(failed)?;
        self.forget_results(id);
        self.forget_incoming(id).await?;
        Ok(true)
    }

    /// Removes the folder of a submission's unfinished uploads.
    pub(crate) async fn forget_incoming(&self, id: SubmissionId) -> Result<(), StoreError> {
        let folder = self.incoming(id);
        match tokio::fs::remove_dir_all(&folder).await {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => Err(StoreError::io("remove", &folder)(error)),
            _ => Ok(()),
        }
    }

    /// Submissions begun before this time, ms since 1970, whose files never arrived.
    pub(crate) async fn stale(&self, before_ms: i64) -> Result<Vec<SubmissionId>, StoreError> {
        let failed = |error| StoreError::database(ASK)(error);
        let rows =
            sqlx::query("SELECT id FROM submissions WHERE state = 'uploading' AND begun < $1 ORDER BY begun, id")
                .bind(before_ms)
                .fetch_all(&self.database.pool)
                .await
                .map_err(failed)?;
        rows.iter().map(|row| id_of(row, "id")).collect()
    }

    /// Digests of all files that the store needs, sorted.
    pub(super) async fn contents(&self) -> Result<Vec<Digest>, StoreError> {
        let failed = |error| StoreError::database(ASK)(error);
        let rows = sqlx::query(
            "SELECT sha256 FROM files WHERE stored = 1 UNION \
             SELECT results FROM submissions WHERE results IS NOT NULL UNION \
             SELECT still FROM pictures UNION SELECT clip FROM pictures ORDER BY 1",
        )
        .fetch_all(&self.database.pool)
        .await
        .map_err(failed)?;
        rows.iter().map(|row| digest_of(&row.try_get::<String, _>(0).map_err(failed)?)).collect()
    }

    pub(crate) async fn states(&self) -> Result<Vec<Count>, StoreError> {
        let rows =
            sqlx::query("SELECT state AS kind, COUNT(*) AS count FROM submissions GROUP BY state ORDER BY state")
                .fetch_all(&self.database.pool)
                .await;
        counts(rows)
    }
}

/// Refuses a submission, unless it was refused before.
pub(super) async fn refuse(tx: &mut Tx, id: SubmissionId, who: &str, reason: &str) -> Result<(), StoreError> {
    let done =
        sqlx::query("UPDATE submissions SET state = 'refused', reason = $2 WHERE id = $1 AND state <> 'refused'")
            .bind(id.to_string())
            .bind(reason)
            .execute(&mut **tx)
            .await
            .map_err(StoreError::database(CHANGE))?;
    if done.rows_affected() == 1 {
        sqlx::query("UPDATE episodes SET verdict = 'dropped' WHERE submission = $1 AND verdict = 'waiting'")
            .bind(id.to_string())
            .execute(&mut **tx)
            .await
            .map_err(StoreError::database(CHANGE))?;
        forget_rows(tx, &id.to_string()).await?;
        audit(tx, who, "submission refused", &id.to_string(), reason).await?;
    }
    Ok(())
}

pub(super) fn counts(rows: Result<Vec<Row>, sqlx::Error>) -> Result<Vec<Count>, StoreError> {
    let failed = |error| StoreError::database("count")(error);
    let of = |row: &Row| Ok(Count { kind: row.try_get("kind")?, count: row.try_get("count")? });
    rows.map_err(failed)?.iter().map(of).collect::<Result<_, _>>().map_err(failed)
}

pub(super) fn id_of(row: &Row, column: &str) -> Result<SubmissionId, StoreError> {
    let text: String = row.try_get(column).map_err(StoreError::database(ASK))?;
    text.parse().map_err(|error| StoreError::corrupt(format!("the id '{text}'"), error))
}

pub(super) fn digest_of(text: &str) -> Result<Digest, StoreError> {
    Digest::parse(text)
        .ok_or_else(|| StoreError::corrupt(format!("the digest '{text}'"), "it is not 64 hexadecimal digits"))
}

fn entry_of(row: &Row, runs: &RunsInputs) -> Result<Entry, StoreError> {
    let id = id_of(row, "id")?;
    let corrupt = |error: serde_json::Error| StoreError::corrupt(format!("submission {id}"), error);
    let text = |column: &str| row.try_get::<String, _>(column).map_err(StoreError::database(ASK));
    let number = |column: &str| row.try_get::<i64, _>(column).map_err(StoreError::database(ASK));
    let facts = row.try_get::<Option<String>, _>("facts").map_err(StoreError::database(ASK))?;
    let facts = facts.map_or(Ok(Facts::default()), |text| facts_in(&text))?;
    let received = row.try_get::<Option<i64>, _>("received").map_err(StoreError::database(ASK))?;
    let (state, reason) = (word_of::<Stage>(&text("state")?).map_err(corrupt)?, text("reason")?);
    let [equal, refused, episodes] = ["done", "refused", "whole"].map(number);
    let progress = Progress { episodes: episodes? as u64, equal: equal? as u64, refused: refused? as u64 };
    let tries = tries_of(&facts.runs, &facts.servers, &runs.runs, &runs.shown, now_ms()).filter(|_| facts.hosted);
    let decided = decide(&facts, state, &reason, progress, tries.as_ref());
    Ok(Entry {
        id,
        manifest: serde_json::from_str(&text("manifest")?).map_err(corrupt)?,
        account: text("account")?,
        tasks: if decided.division.is_some() { facts.tasks.clone() } else { Vec::new() },
        division: decided.division,
        badge: decided.badge,
        claims: decided.claims,
        senses: if facts.time.is_empty() { String::new() } else { facts.senses() },
        obstacle: decided.obstacle,
        failed_tries: tries.map(|tries| tries.failed).unwrap_or_default(),
        state,
        reason,
        received: moment(received.map_or_else(|| number("begun"), Ok)?),
        progress: (progress.equal, progress.episodes),
    })
}
