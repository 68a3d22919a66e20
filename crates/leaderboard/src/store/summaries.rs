//! The part of a submission's results that the tables show, so that a service that starts does not read all results again.

use std::collections::BTreeMap;

use sqlx::Row as _;

use super::Store;
use super::submissions::id_of;
use crate::{StoreError, SubmissionId};

impl Store {
    /// The summaries of all submissions that have one in this layout, of their present results.
    pub(crate) async fn summaries(&self, layout: i64) -> Result<BTreeMap<SubmissionId, String>, StoreError> {
        let failed = |error| StoreError::database("be asked for summaries")(error);
        let rows = sqlx::query(
            "SELECT s.id, u.summary FROM summaries u JOIN submissions s ON s.id = u.submission AND s.results = u.results \
             WHERE u.layout = $1",
        )
        .bind(layout)
        .fetch_all(&self.database.pool)
        .await
        .map_err(failed)?;
        rows.iter().map(|row| Ok((id_of(row, "id")?, row.try_get("summary").map_err(failed)?))).collect()
    }

    /// Keeps summaries in this layout, of the present results.
    pub(crate) async fn set_summaries(
        &self,
        layout: i64,
        summaries: &[(SubmissionId, String)],
    ) -> Result<(), StoreError> {
        let failed = |error| StoreError::database("take summaries")(error);
        let mut tx = self.write().await?;
        for (id, summary) in summaries {
            sqlx::query(
                "INSERT INTO summaries (submission, results, layout, summary) \
                 SELECT id, results, $2, $3 FROM submissions WHERE id = $1 AND results IS NOT NULL \
                 ON CONFLICT (submission) DO UPDATE SET results = excluded.results, layout = excluded.layout, \
                 summary = excluded.summary",
            )
            .bind(id.to_string())
            .bind(layout)
            .bind(summary)
            .execute(&mut *tx)
            .await
            .map_err(failed)?;
        }
        tx.commit().await.map_err(failed)
    }
}
