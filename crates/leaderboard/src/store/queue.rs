//! The queue of jobs. There is no separate list: every submission in the state `received` waits to be graded, and every
//! episode with the verdict `waiting` waits to be verified. So no accepted submission can be lost, and nothing is decided twice.

use sqlx::Row as _;
use sqlx::sqlite::SqliteRow;

use super::accounts::audit;
use super::submissions::{badge_text, counts, digest_of, division_text, id_of, refuse};
use super::{Count, Digest, Store};
use crate::{Badge, Division, StoreError, SubmissionId};

const ASK: &str = "be asked for work";
const CHANGE: &str = "take the outcome of a job";

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Verdict {
    /// The second run was equal to the last bit.
    Equal,
    /// The second run differed, which refuses the whole submission.
    Differs,
    /// The servers refuse to play it, so it cannot be verified.
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
    /// It can be verified by simulating it again.
    pub verify: bool,
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
    pub(crate) async fn set_graded(
        &self,
        id: SubmissionId,
        results: &Digest,
        badge: Badge,
        division: Option<&Division>,
        episodes: &[EpisodePlan],
    ) -> Result<(), StoreError> {
        let failed = |error| StoreError::database(CHANGE)(error);
        let waits = episodes.iter().any(|episode| episode.verify);
        let mut tx = self.write().await?;
        let done = sqlx::query(
            "UPDATE submissions SET state = $2, results = $3, badge = $4, division = $5 \
             WHERE id = $1 AND state = 'received'",
        )
        .bind(id.to_string())
        .bind(if waits { "graded" } else { "verified" })
        .bind(results.as_str())
        .bind(badge_text(badge))
        .bind(division.map(division_text).transpose()?)
        .execute(&mut *tx)
        .await
        .map_err(failed)?;
        if done.rows_affected() == 0 {
            return Ok(());
        }
        for episode in episodes {
            sqlx::query(
                "INSERT INTO episodes (submission, task, seed, episode, place, verdict, server, detail) \
                 VALUES ($1, $2, $3, $4, $5, $6, '', '')",
            )
            .bind(id.to_string())
            .bind(&episode.task)
            .bind(episode.seed.to_string())
            .bind(episode.episode.to_string())
            .bind(episode.place)
            .bind(if episode.verify { "waiting" } else { "none" })
            .execute(&mut *tx)
            .await
            .map_err(failed)?;
        }
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

    /// Stores the verdict on an episode. The last one of a submission sets its badge; one that differs refuses the submission.
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
        if verdict == Verdict::Differs {
            refuse(&mut tx, job.submission, "service", &format!("{job}: {detail}")).await?;
            return tx.commit().await.map_err(failed);
        }
        let row = sqlx::query(
            "SELECT (SELECT COUNT(*) FROM episodes WHERE submission = $1 AND verdict = 'waiting') AS waiting, \
             (SELECT COUNT(*) FROM episodes WHERE submission = $1 AND verdict = 'refused') AS refused",
        )
        .bind(&id)
        .fetch_one(&mut *tx)
        .await
        .map_err(failed)?;
        let count = |column| row.try_get::<i64, _>(column).map_err(failed);
        if count("waiting")? == 0 {
            let badge = if count("refused")? == 0 { Badge::Replayed } else { Badge::SelfReported };
            let hosted = badge_text(Badge::Hosted);
            sqlx::query(
                "UPDATE submissions SET state = 'verified', badge = CASE WHEN badge = $2 THEN badge ELSE $3 END \
                 WHERE id = $1 AND state = 'graded'",
            )
            .bind(&id)
            .bind(hosted)
            .bind(badge_text(badge))
            .execute(&mut *tx)
            .await
            .map_err(failed)?;
            audit(&mut tx, "service", "submission verified", &id, &format!("{} not replayed", count("refused")?))
                .await?;
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
