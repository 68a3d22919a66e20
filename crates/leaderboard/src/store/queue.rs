//! The queue of jobs. There is no separate list: every submission in the state `received` waits to be graded, and every
//! episode with the verdict `waiting` waits to be verified. So no accepted submission can be lost, and nothing is decided twice.

use std::collections::BTreeSet;

use sqlx::Row as _;
use sqlx::sqlite::SqliteRow;

use super::accounts::audit;
use super::facts::{facts_in, facts_text};
use super::known::{EpisodeRows, own, take_place};
use super::submissions::{counts, digest_of, id_of, refuse};
use super::{Count, Digest, Store};
use crate::claims::{Consequence, Facts, Label, consequence};
use crate::{StoreError, SubmissionId};

const ASK: &str = "be asked for work";
const CHANGE: &str = "take the outcome of a job";

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Verdict {
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

#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct EpisodeJob {
    pub submission: SubmissionId,
    pub task: String,
    pub seed: String,
    pub episode: String,
    pub bag: Digest,
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
            .fetch_optional(&self.pool)
            .await
            .map_err(StoreError::database(ASK))?;
        row.map(|row| id_of(&row, "id")).transpose()
    }

    /// Stores the outcome of grading. Does nothing if the submission is graded already.
    pub(crate) async fn set_graded(&self, id: SubmissionId, graded: &Graded<'_>) -> Result<(), StoreError> {
        let failed = |error| StoreError::database(CHANGE)(error);
        let Graded { account, results, facts, episodes, label, rows, replaces } = graded;
        let mut tx = self.write().await?;
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
                "INSERT INTO episodes (submission, task, seed, episode, place, verdict, server, detail) \
                 VALUES ($1, $2, $3, $4, $5, 'waiting', '', '')",
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

    /// Episodes that wait to be verified, those of the oldest submission first.
    pub(crate) async fn waiting(&self, most: i64) -> Result<Vec<EpisodeJob>, StoreError> {
        let failed = |error| StoreError::database(ASK)(error);
        let rows = sqlx::query(
            "SELECT e.submission, e.task, e.seed, e.episode, f.sha256 FROM episodes e \
             JOIN submissions s ON s.id = e.submission \
             JOIN files f ON f.submission = e.submission AND f.place = e.place \
             WHERE e.verdict = 'waiting' AND s.state = 'graded' \
             ORDER BY s.received, s.id, e.task, e.seed, e.episode LIMIT $1",
        )
        .bind(most)
        .fetch_all(&self.pool)
        .await
        .map_err(failed)?;
        let job_of = |row: &SqliteRow| {
            Ok(EpisodeJob {
                submission: id_of(row, "submission")?,
                task: row.try_get("task").map_err(failed)?,
                seed: row.try_get("seed").map_err(failed)?,
                episode: row.try_get("episode").map_err(failed)?,
                bag: digest_of(&row.try_get::<String, _>("sha256").map_err(failed)?)?,
            })
        };
        rows.iter().map(job_of).collect()
    }

    /// Stores the verdict on an episode, with its consequence for the submission.
    pub(crate) async fn set_verdict(
        &self,
        job: &EpisodeJob,
        verdict: Verdict,
        server: &str,
        detail: &str,
    ) -> Result<(), StoreError> {
        let failed = |error| StoreError::database(CHANGE)(error);
        let id = job.submission.to_string();
        let mut tx = self.write().await?;
        let done = sqlx::query(
            "UPDATE episodes SET verdict = $5, server = $6, detail = $7 \
             WHERE submission = $1 AND task = $2 AND seed = $3 AND episode = $4 AND verdict = 'waiting'",
        )
        .bind(&id)
        .bind(&job.task)
        .bind(&job.seed)
        .bind(&job.episode)
        .bind(verdict.word())
        .bind(server)
        .bind(detail)
        .execute(&mut *tx)
        .await
        .map_err(failed)?;
        if done.rows_affected() == 0 {
            return Ok(());
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
        tx.commit().await.map_err(failed)
    }

    pub(crate) async fn verdicts(&self) -> Result<Vec<Count>, StoreError> {
        let rows =
            sqlx::query("SELECT verdict AS kind, COUNT(*) AS count FROM episodes GROUP BY verdict ORDER BY verdict")
                .fetch_all(&self.pool)
                .await;
        counts(rows)
    }
}
