//! Pictures of episodes: the best success of each subtask of a submission, drawn once.

use std::collections::BTreeMap;

use sqlx::Row as _;

use super::submissions::{digest_of, id_of};
use super::{Digest, Store, now_ms};
use crate::{StoreError, SubmissionId};

const ASK: &str = "be asked for pictures";
const CHANGE: &str = "store pictures";

/// Pictures of one episode, by the digests of their files.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Picture {
    pub seed: u64,
    pub episode: u64,
    /// A PNG file.
    pub still: Digest,
    /// An animated PNG file.
    pub clip: Digest,
}

/// The pictures of all submissions, by submission and short id of the subtask.
pub(crate) type Pictures = BTreeMap<(SubmissionId, String), Picture>;

impl Store {
    /// The verified submission that has waited longest for its pictures.
    pub(crate) async fn next_undrawn(&self) -> Result<Option<SubmissionId>, StoreError> {
        let row = sqlx::query(
            "SELECT id FROM submissions WHERE state = 'verified' AND drawn IS NULL ORDER BY received, id LIMIT 1",
        );
        let row = row.fetch_optional(&self.pool).await.map_err(StoreError::database(ASK))?;
        row.map(|row| id_of(&row, "id")).transpose()
    }

    /// Stores pictures of a submission, each with its subtask. It is not drawn again.
    pub(crate) async fn set_drawn(&self, id: SubmissionId, drawn: &[(String, Picture)]) -> Result<(), StoreError> {
        let failed = |error| StoreError::database(CHANGE)(error);
        let mut tx = self.write().await?;
        for (task, picture) in drawn {
            sqlx::query(
                "INSERT INTO pictures (submission, task, seed, episode, still, clip) VALUES ($1, $2, $3, $4, $5, $6) \
                 ON CONFLICT (submission, task) DO NOTHING",
            )
            .bind(id.to_string())
            .bind(task)
            .bind(picture.seed.to_string())
            .bind(picture.episode.to_string())
            .bind(picture.still.as_str())
            .bind(picture.clip.as_str())
            .execute(&mut *tx)
            .await
            .map_err(failed)?;
        }
        sqlx::query("UPDATE submissions SET drawn = $2 WHERE id = $1")
            .bind(id.to_string())
            .bind(now_ms())
            .execute(&mut *tx)
            .await
            .map_err(failed)?;
        tx.commit().await.map_err(failed)
    }

    pub(crate) async fn pictures(&self) -> Result<Pictures, StoreError> {
        let failed = |error| StoreError::database(ASK)(error);
        let rows = sqlx::query("SELECT * FROM pictures").fetch_all(&self.pool).await.map_err(failed)?;
        let picture_of = |row: &sqlx::sqlite::SqliteRow| {
            let text = |column| row.try_get::<String, _>(column).map_err(failed);
            let number = |column| {
                text(column)?.parse::<u64>().map_err(|error| StoreError::corrupt("a picture's episode", error))
            };
            let picture = Picture {
                seed: number("seed")?,
                episode: number("episode")?,
                still: digest_of(&text("still")?)?,
                clip: digest_of(&text("clip")?)?,
            };
            Ok(((id_of(row, "submission")?, text("task")?), picture))
        };
        rows.iter().map(picture_of).collect()
    }
}
