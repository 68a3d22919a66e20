//! The queue of jobs. There is no separate list: every submission in the state `received` waits to be graded, and every
//! episode with the verdict `waiting` waits to be verified. So no accepted submission can be lost, and nothing is decided twice.
//!
//! Who verifies an episode claims it for a while and renews the claim meanwhile. Threads and processes claim by one statement,
//! one after the other. The claim of one that was killed ends by itself. Each claim has a number, so a verdict of an earlier
//! claim counts for nothing.

use std::collections::BTreeSet;
use std::time::Duration;

use sqlx::{AssertSqlSafe, Row as _};

use super::accounts::audit;
use super::database::Row;
use super::facts::{facts_in, facts_text};
use super::known::{EpisodeRows, own, take_place};
use super::lease::{MAX_PAUSE, after};
use super::submissions::{counts, digest_of, id_of, refuse};
use super::{Count, Digest, Store, Term, now_ms};
use crate::claims::{Consequence, Facts, Label, consequence};
use crate::{StoreError, SubmissionId};

/// Selects the free episode for servers of a version that has waited longest.
macro_rules! free {
    ($version:literal) => {
        concat!(
            "SELECT e.queue, e.submission, e.task, e.seed, e.episode FROM episodes e \
             WHERE e.verdict = 'waiting' AND e.leased_until = 0 AND e.version = ",
            $version,
            " AND (SELECT s.state FROM submissions s WHERE s.id = e.submission) = 'graded' \
             ORDER BY e.queue, e.submission, e.task, e.seed, e.episode LIMIT 1 /* FOR UPDATE */"
        )
    };
}

/// Claims and pauses whose time is over (`$1`: now), and those whose end is too far away (`$1`: the last moment that is not). Free
/// episodes have one value, 0, so that the index has them in order.
const ENDED: &str = "verdict = 'waiting' AND leased_until > 0 AND leased_until <= $1";
const FAR: &str = "verdict = 'waiting' AND leased_until > $1";
/// Free episodes that wait for a server of a certain version.
const WANTING: &str = "verdict = 'waiting' AND leased_until = 0 AND version > ''";

const ASK: &str = "be asked for work";
const CHANGE: &str = "take the outcome of a job";

/// Claims the free episode that has waited longest, of those for any server and those for this version (`$1`): each is the first one of an
/// index, as long as refused submissions have none that wait. One statement, so that nobody waits for more than that. The one to claim is
/// picked once, however the database comes to its row.
const CLAIM: &str = concat!(
    "WITH picked AS MATERIALIZED (SELECT * FROM (SELECT * FROM (",
    free!("''"),
    ") any_server UNION ALL SELECT * FROM (",
    free!("$1"),
    ") own_version) free ORDER BY queue, submission, task, seed, episode LIMIT 1) \
     UPDATE episodes SET attempt = attempt + 1, leased_until = $2 WHERE (submission, task, seed, episode) IN \
     (SELECT submission, task, seed, episode FROM picked) RETURNING submission, task, seed, episode, attempt, refusals, \
     (SELECT f.sha256 FROM files f WHERE f.submission = episodes.submission AND f.place = episodes.place) AS sha256"
);

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// The second run was equal to the last bit.
    Equal,
    /// The second run differed, which refuses the whole submission.
    Differs,
    /// The servers refuse to play it, which refuses the whole submission unless its own server saw it.
    Refused,
}

impl Verdict {
    fn word(self) -> &'static str {
        match self {
            Verdict::Equal => "equal",
            Verdict::Differs => "differs",
            Verdict::Refused => "refused",
        }
    }
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct EpisodePlan {
    pub task: String,
    pub seed: u64,
    pub episode: u64,
    /// Index of its bag in the submission's files.
    pub place: i64,
}

/// The outcome of grading.
#[derive(Debug)]
pub(crate) struct Graded<'a> {
    pub account: &'a str,
    /// Digest of its results.
    pub results: Digest,
    pub facts: Facts,
    pub episodes: Vec<EpisodePlan>,
    pub label: Label,
    pub rows: Vec<EpisodeRows>,
    /// Submissions of the same account with the same episodes, which it replaces.
    pub replaces: BTreeSet<String>,
}

/// An episode that its holder has claimed to verify it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct EpisodeJob {
    pub submission: SubmissionId,
    pub task: String,
    pub seed: String,
    pub episode: String,
    pub bag: Digest,
    /// Number of the claim: each of the episode has the next one.
    pub attempt: i64,
    /// Number of refusals by servers of the bag's version so far.
    pub refusals: i64,
}

/// The reason for which an episode goes back to the queue.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Return {
    Unplayed,
    /// A server of the bag's version refuses to play it.
    Refused,
    /// A server of another version plays it otherwise: only one of this version may claim it from now on.
    OtherVersion(String),
}

impl std::fmt::Display for EpisodeJob {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}, seed {}, episode {}", self.task, self.seed, self.episode)
    }
}

impl Store {
    /// The submission that has waited longest to be graded.
    pub(crate) async fn next_received(&self) -> Result<Option<SubmissionId>, StoreError> {
        let row = sqlx::query("SELECT id FROM submissions WHERE state = 'received' ORDER BY received, id LIMIT 1")
            .fetch_optional(&self.database.pool)
            .await
            .map_err(StoreError::database(ASK))?;
        row.map(|row| id_of(&row, "id")).transpose()
    }

    /// Stores the outcome of grading. Does nothing if the submission is graded already, or if another scorer grades now.
    pub(crate) async fn set_graded(&self, term: Term, id: SubmissionId, graded: &Graded<'_>) -> Result<(), StoreError> {
        let failed = |error| StoreError::database(CHANGE)(error);
        let Graded { account, results, facts, episodes, label, rows, replaces } = graded;
        let Some(mut tx) = self.write_on(term).await? else { return Ok(()) };
        let done = sqlx::query(
            "UPDATE submissions SET state = 'graded', results = $2, facts = $3 WHERE id = $1 AND state = 'received'",
        )
        .bind(id.to_string())
        .bind(results.as_str())
        .bind(facts_text(facts)?)
        .execute(&mut *tx)
        .await
        .map_err(failed)?;
        if done.rows_affected() == 0 {
            return Ok(());
        }
        for episode in episodes {
            sqlx::query(
                "INSERT INTO episodes (submission, task, seed, episode, place, verdict, server, detail, queue) \
                 SELECT s.id, $2, $3, $4, $5, 'waiting', '', '', s.received FROM submissions s WHERE s.id = $1",
            )
            .bind(id.to_string())
            .bind(&episode.task)
            .bind(episode.seed.to_string())
            .bind(episode.episode.to_string())
            .bind(episode.place)
            .execute(&mut *tx)
            .await
            .map_err(failed)?;
        }
        // The same bytes have the same verdict, such as in a submission that this one replaces.
        sqlx::query(
            "UPDATE episodes SET verdict = 'equal' WHERE submission = $1 AND EXISTS \
             (SELECT 1 FROM files f JOIN files o ON o.sha256 = f.sha256 \
             JOIN episodes e ON e.submission = o.submission AND e.place = o.place \
             WHERE f.submission = episodes.submission AND f.place = episodes.place AND e.verdict = 'equal')",
        )
        .bind(id.to_string())
        .execute(&mut *tx)
        .await
        .map_err(failed)?;
        sqlx::query(
            "UPDATE submissions SET state = 'verified' WHERE id = $1 AND NOT EXISTS \
             (SELECT 1 FROM episodes e WHERE e.submission = $1 AND e.verdict = 'waiting')",
        )
        .bind(id.to_string())
        .execute(&mut *tx)
        .await
        .map_err(failed)?;
        own(&mut tx, id, account, label, replaces, rows).await?;
        let detail = format!("{} episodes with bags", episodes.len());
        audit(&mut tx, "service", "submission graded", &id.to_string(), &detail).await?;
        tx.commit().await.map_err(failed)
    }

    /// Claims the episode that has waited longest, for a server of this version, which is empty if it is not known. One whose claim has
    /// ended has its old place in the queue.
    pub(crate) async fn claim(&self, version: &str, lease: Duration) -> Result<Option<EpisodeJob>, StoreError> {
        let failed = |error| StoreError::database(ASK)(error);
        let now = now_ms();
        for (which, limit) in [(ENDED, now), (FAR, after(now, MAX_PAUSE))] {
            let found = sqlx::query(AssertSqlSafe(one_of(which))).bind(limit).fetch_optional(&self.database.pool).await;
            if found.map_err(failed)?.is_some() {
                let free = format!("UPDATE episodes SET leased_until = 0 WHERE {which}");
                // It changes many rows, so it takes its turn with other such changes.
                let mut tx = self.write().await?;
                sqlx::query(AssertSqlSafe(free)).bind(limit).execute(&mut *tx).await.map_err(failed)?;
                tx.commit().await.map_err(failed)?;
            }
        }
        let claimed = sqlx::query(AssertSqlSafe(self.database.passing_by(CLAIM)))
            .bind(version)
            .bind(after(now, lease))
            .fetch_optional(&self.database.writer)
            .await
            .map_err(failed)?;
        claimed.map(|row| job_of(&row)).transpose()
    }

    /// True if an episode that is free waits for a server of a certain version.
    pub(crate) async fn wants_version(&self) -> Result<bool, StoreError> {
        let row = sqlx::query(AssertSqlSafe(one_of(WANTING))).fetch_optional(&self.database.pool).await;
        Ok(row.map_err(StoreError::database(ASK))?.is_some())
    }

    /// Makes a claim last for `lease` from now on; returns `false` if it is no longer the holder's.
    pub(crate) async fn renew(&self, job: &EpisodeJob, lease: Duration) -> Result<bool, StoreError> {
        self.set_lease(job, after(now_ms(), lease), &Return::Unplayed).await
    }

    /// Gives an episode back, to be claimed again after a pause. Does nothing if another holder has claimed it meanwhile.
    pub(crate) async fn release(&self, job: &EpisodeJob, pause: Duration, why: &Return) -> Result<(), StoreError> {
        let until = if pause.is_zero() { 0 } else { after(now_ms(), pause.min(MAX_PAUSE)) };
        self.set_lease(job, until, why).await.map(drop)
    }

    async fn set_lease(&self, job: &EpisodeJob, until: i64, why: &Return) -> Result<bool, StoreError> {
        let version = if let Return::OtherVersion(version) = why { version } else { "" };
        let done = sqlx::query(
            "UPDATE episodes SET leased_until = $6, refusals = refusals + $7, \
             version = CASE WHEN $8 = '' THEN version ELSE $8 END WHERE submission = $1 AND task = $2 \
             AND seed = $3 AND episode = $4 AND attempt = $5 AND verdict = 'waiting'",
        )
        .bind(job.submission.to_string())
        .bind(&job.task)
        .bind(&job.seed)
        .bind(&job.episode)
        .bind(job.attempt)
        .bind(until)
        .bind(i64::from(*why == Return::Refused))
        .bind(version)
        .execute(&self.database.writer)
        .await
        .map_err(StoreError::database(CHANGE))?;
        Ok(done.rows_affected() == 1)
    }

    /// Stores the verdict on an episode, with its consequence for the submission. Does nothing, and returns `false`, if the claim
    /// ended and the episode was claimed again.
    pub(crate) async fn set_verdict(
        &self,
        job: &EpisodeJob,
        verdict: Verdict,
        server: &str,
        detail: &str,
    ) -> Result<bool, StoreError> {
        let failed = |error| StoreError::database(CHANGE)(error);
        let id = job.submission.to_string();
        let mut tx = self.write().await?;
        let done = sqlx::query(
            "UPDATE episodes SET verdict = $5, server = $6, detail = $7 \
             WHERE submission = $1 AND task = $2 AND seed = $3 AND episode = $4 AND attempt = $8 AND verdict = 'waiting'",
        )
        .bind(&id)
        .bind(&job.task)
        .bind(&job.seed)
        .bind(&job.episode)
        .bind(verdict.word())
        .bind(server)
        .bind(detail)
        .bind(job.attempt)
        .execute(&mut *tx)
        .await
        .map_err(failed)?;
        if done.rows_affected() == 0 {
            return Ok(false);
        }
        let row = sqlx::query(
            "SELECT s.facts, (SELECT COUNT(*) FROM episodes e WHERE e.submission = s.id AND e.verdict = 'waiting') AS waiting \
             FROM submissions s WHERE s.id = $1",
        )
        .bind(&id)
        .fetch_one(&mut *tx)
        .await
        .map_err(failed)?;
        let waiting = row.try_get::<i64, _>("waiting").map_err(failed)? as u64;
        let facts = row.try_get::<Option<String>, _>("facts").map_err(failed)?;
        let hosted = facts.map(|text| facts_in(&text)).transpose()?.is_some_and(|facts| facts.hosted);
        match consequence(hosted, verdict == Verdict::Differs, verdict == Verdict::Refused, waiting) {
            Consequence::Refused => refuse(&mut tx, job.submission, "service", &format!("{job}: {detail}")).await?,
            Consequence::Verified => {
                let state = "UPDATE submissions SET state = 'verified' WHERE id = $1 AND state = 'graded'";
                sqlx::query(state).bind(&id).execute(&mut *tx).await.map_err(failed)?;
                take_place(&mut tx, job.submission).await?;
                audit(&mut tx, "service", "submission verified", &id, "").await?;
            }
            Consequence::Waits => {}
        }
        tx.commit().await.map_err(failed)?;
        Ok(true)
    }

    pub(crate) async fn verdicts(&self) -> Result<Vec<Count>, StoreError> {
        let rows =
            sqlx::query("SELECT verdict AS kind, COUNT(*) AS count FROM episodes GROUP BY verdict ORDER BY verdict")
                .fetch_all(&self.database.pool)
                .await;
        counts(rows)
    }
}

/// Looks for one of these episodes, in the order of the index: without one PostgreSQL reads the whole table, since it takes a third of all
/// rows for a hit where it does not know the value.
fn one_of(which: &str) -> String {
    format!("SELECT 1 FROM episodes WHERE {which} ORDER BY leased_until, version LIMIT 1")
}

fn job_of(row: &Row) -> Result<EpisodeJob, StoreError> {
    let failed = |error| StoreError::database(ASK)(error);
    let text = |column| row.try_get::<String, _>(column).map_err(failed);
    Ok(EpisodeJob {
        submission: id_of(row, "submission")?,
        task: text("task")?,
        seed: text("seed")?,
        episode: text("episode")?,
        bag: digest_of(&text("sha256")?)?,
        attempt: row.try_get("attempt").map_err(failed)?,
        refusals: row.try_get("refusals").map_err(failed)?,
    })
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
pub(crate) mod tests;
