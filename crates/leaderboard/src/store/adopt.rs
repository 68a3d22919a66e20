//! Entries of older versions of the service get what the present rules need: facts in place of a badge and a division. Their
//! files stay as they are, and what follows from the facts is decided anew whenever it is read.

use fiatlux_cli::in_full;
use sqlx::Row as _;

use super::facts::facts_text;
use super::submissions::{id_of, refuse};
use super::{Store, StoreError};
use crate::claims::{Consequence, Facts, consequence};

const CHANGE: &str = "be migrated";

impl Store {
    /// Adopts every graded submission without facts. Interrupted, it goes on at the next start.
    pub(super) async fn adopt(&self) -> Result<(), StoreError> {
        let failed = |error| StoreError::database(CHANGE)(error);
        let rows = sqlx::query(
            "SELECT id, badge, (SELECT COUNT(*) FROM episodes e WHERE e.submission = s.id AND e.verdict = 'refused') AS refused \
             FROM submissions s WHERE s.facts IS NULL AND s.results IS NOT NULL ORDER BY s.received, s.id",
        )
        .fetch_all(&self.database.pool)
        .await
        .map_err(failed)?;
        for row in &rows {
            let id = id_of(row, "id")?;
            let hosted = row.try_get::<String, _>("badge").map_err(failed)? == "hosted";
            let refused = row.try_get::<i64, _>("refused").map_err(failed)? > 0;
            let facts = match self.results(id).await {
                Ok(Some(results)) => Facts::of(&results, hosted),
                Ok(None) => continue,
                Err(error) => {
                    tracing::error!(submission = %id, error = in_full(&error), "its results cannot be read; it is not ranked");
                    Facts { deviation: "its results cannot be read".into(), ..Facts::default() }
                }
            };
            let mut tx = self.write().await?;
            sqlx::query("UPDATE submissions SET facts = $2 WHERE id = $1")
                .bind(id.to_string())
                .bind(facts_text(&facts)?)
                .execute(&mut *tx)
                .await
                .map_err(failed)?;
            // Episodes in real time were not simulated again by those versions.
            sqlx::query("UPDATE episodes SET verdict = 'waiting' WHERE submission = $1 AND verdict = 'none'")
                .bind(id.to_string())
                .execute(&mut *tx)
                .await
                .map_err(failed)?;
            if consequence(facts.hosted, false, refused, 1) == Consequence::Refused {
                let reason = "an episode could not be simulated again, which refuses all of them; submit it again";
                refuse(&mut tx, id, "service", reason).await?;
            }
            sqlx::query(
                "UPDATE submissions SET state = 'graded' WHERE id = $1 AND state = 'verified' AND EXISTS \
                 (SELECT 1 FROM episodes e WHERE e.submission = $1 AND e.verdict = 'waiting')",
            )
            .bind(id.to_string())
            .execute(&mut *tx)
            .await
            .map_err(failed)?;
            tx.commit().await.map_err(failed)?;
        }
        if !rows.is_empty() {
            tracing::info!(submissions = rows.len(), "entries of an older version are judged by the present rules");
        }
        Ok(())
    }
}
