//! Pictures of episodes: the best success of each subtask of a submission, drawn once.

use std::collections::{BTreeMap, BTreeSet};

use sqlx::Row as _;

use super::database::Row;
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
    /// The submission that has waited longest for its pictures: a verified one, else one that is being verified, whose badge then
    /// comes with pictures.
    pub(crate) async fn next_undrawn(&self) -> Result<Option<SubmissionId>, StoreError> {
        let row = sqlx::query(
            "SELECT id FROM submissions s WHERE drawn IS NULL AND (state = 'verified' OR (state = 'graded' AND EXISTS \
             (SELECT 1 FROM episodes e WHERE e.submission = s.id AND e.verdict = 'equal'))) \
             ORDER BY state DESC, received, id LIMIT 1",
        );
        let row = row.fetch_optional(&self.database.pool).await.map_err(StoreError::database(ASK))?;
        row.map(|row| id_of(&row, "id")).transpose()
    }

    /// Stores the pictures of a subtask, which are shown from then on.
    pub(crate) async fn set_picture(&self, id: SubmissionId, task: &str, picture: &Picture) -> Result<(), StoreError> {
        let failed = |error| StoreError::database(CHANGE)(error);
        let mut tx = self.write().await?;
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
        tx.commit().await.map_err(failed)
    }

    /// Subtasks of which a submission has pictures.
    pub(crate) async fn pictured(&self, id: SubmissionId) -> Result<BTreeSet<String>, StoreError> {
        let failed = |error| StoreError::database(ASK)(error);
        let rows = sqlx::query("SELECT task FROM pictures WHERE submission = $1").bind(id.to_string());
        let rows = rows.fetch_all(&self.database.pool).await.map_err(failed)?;
        rows.iter().map(|row| row.try_get("task").map_err(failed)).collect()
    }

    /// Notes that a submission has its pictures; it is not drawn again.
    pub(crate) async fn set_drawn(&self, id: SubmissionId) -> Result<(), StoreError> {
        let failed = |error| StoreError::database(CHANGE)(error);
        let mut tx = self.write().await?;
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
        let rows = sqlx::query("SELECT * FROM pictures").fetch_all(&self.database.pool).await.map_err(failed)?;
        let picture_of = |row: &Row| {
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

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::store::queue::tests::{Folder, fill};

    /// Guards that a badge comes with pictures: they are drawn while episodes are verified, from the first that is equal on, and each is
    /// shown at once. Nobody has pictures drawn without a proof.
    #[tokio::test]
    async fn pictures_are_drawn_while_episodes_are_verified() {
        let folder = Folder::new("pictures");
        let store = Store::of_test(&folder.0).await.unwrap();
        fill(&store, 2, 3).await;
        let run = async |statement: &'static str| {
            sqlx::query(statement).execute(&store.database.writer).await.unwrap();
        };
        assert_eq!(store.next_undrawn().await.unwrap(), None);
        run("UPDATE episodes SET verdict = 'equal' WHERE seed = '1' AND submission LIKE '%1'").await;
        let (one, two) = (SubmissionId(1), SubmissionId(2));
        assert_eq!(store.next_undrawn().await.unwrap(), Some(one));
        let [still, clip] = [b'a', b'b'].map(|byte| Digest::of(&[byte]));
        let picture = Picture { seed: 7, episode: 0, still, clip };
        store.set_picture(one, "S05", &picture).await.unwrap();
        assert_eq!(store.pictures().await.unwrap(), Pictures::from([((one, "S05".to_owned()), picture)]));
        assert_eq!(store.pictured(one).await.unwrap(), BTreeSet::from(["S05".to_owned()]));
        assert_eq!(store.next_undrawn().await.unwrap(), Some(one), "a service that was stopped goes on");
        run("UPDATE submissions SET state = 'verified' WHERE id LIKE '%2'").await;
        assert_eq!(store.next_undrawn().await.unwrap(), Some(two), "verified ones first");
        store.set_drawn(two).await.unwrap();
        store.set_drawn(one).await.unwrap();
        assert_eq!(store.next_undrawn().await.unwrap(), None);
    }
}
