//! Knowledge of the board besides its entries: rows that somebody submitted first, and hosted runs on its servers.

use std::collections::btree_map::Entry as Slot;
use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;

use fiatlux_bag::BagFiles;
use fiatlux_cli::in_full;
use fiatlux_grading::rows_of;
use sqlx::Row as _;

use super::accounts::audit;
use super::database::{Row, Tx};
use super::facts::{RunsInputs, facts_in};
use super::{Digest, Store, Term, now_ms};
use crate::claims::{HostedRun, KnownRow, Label};
use crate::{StoreError, SubmissionId};

const ASK: &str = "be asked for known rows";
const CHANGE: &str = "take known rows";

/// Rows of one episode.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct EpisodeRows {
    pub task: String,
    pub seed: u64,
    /// Digest of the rows alone.
    pub digest: String,
}

/// Summary of what [`Store::know_bags`] noted.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct KnownBags {
    /// Number of episodes that were not known before, and of bags.
    pub new: u64,
    pub bags: u64,
    /// Bags that cannot be read, with the reason.
    pub unread: Vec<String>,
}

impl Store {
    /// Those of these rows that are known, and the number of rows of each submission among them.
    pub(crate) async fn known_rows(
        &self,
        rows: &[EpisodeRows],
    ) -> Result<(Vec<KnownRow>, BTreeMap<String, u64>), StoreError> {
        let failed = |error| StoreError::database(ASK)(error);
        let (mut known, mut count) = (Vec::new(), BTreeMap::new());
        for EpisodeRows { digest, task, seed } in rows {
            let found = sqlx::query("SELECT * FROM known_rows WHERE rows = $1")
                .bind(digest)
                .fetch_optional(&self.database.pool);
            let Some(row) = found.await.map_err(failed)? else { continue };
            let row = known_row(&row, (task.clone(), *seed)).map_err(failed)?;
            if let Slot::Vacant(slot) = count.entry(row.first.clone()) {
                let all = sqlx::query("SELECT COUNT(*) AS count FROM known_rows WHERE submission = $1")
                    .bind(&row.first)
                    .fetch_one(&self.database.pool)
                    .await
                    .map_err(failed)?;
                slot.insert(all.try_get::<i64, _>("count").map_err(failed)? as u64);
            }
            known.push(row);
        }
        Ok((known, count))
    }

    /// Notes rows of a person, whoever had them first: nobody may submit them as those of a policy. Rows that are known stay
    /// as they are. Returns the number of new ones.
    pub(crate) async fn know_persons(
        &self,
        first: &str,
        account: &str,
        policy: &str,
        rows: &[EpisodeRows],
    ) -> Result<u64, StoreError> {
        let label = Label { policy: policy.into(), senses: String::new() };
        let mut tx = self.write().await?;
        let count = know(&mut tx, first, account, &label, true, rows).await?;
        audit(&mut tx, "service", "rows of a person known", first, &format!("{count} episodes")).await?;
        tx.commit().await.map_err(StoreError::database(CHANGE))?;
        Ok(count)
    }

    /// Notes the rows of these bags, takes or not: nobody may submit them as their own. `name` is what a refusal calls them.
    pub async fn know_bags(&self, name: &str, paths: &[PathBuf]) -> Result<KnownBags, StoreError> {
        let found = BagFiles::find(paths).map_err(|error| StoreError::corrupt("the bags", in_full(&error)))?;
        let mut known = KnownBags { bags: found.bags.len() as u64, ..KnownBags::default() };
        for path in found.bags {
            let read = tokio::task::spawn_blocking(move || {
                rows_of(&path, None).map_err(|error| format!("{}: {}", path.display(), in_full(&error)))
            });
            let bag = match read.await.map_err(|_| StoreError::corrupt("a bag", "a thread ended early"))? {
                Ok(bag) => bag,
                Err(reason) => {
                    known.unread.push(reason);
                    continue;
                }
            };
            let label = Label { policy: bag.policy, senses: String::new() };
            let rows = [EpisodeRows { task: bag.task, seed: bag.seed, digest: bag.digest }];
            let mut tx = self.write().await?;
            // No account has this name.
            known.new += know(&mut tx, name, "the administrator", &label, bag.person, &rows).await?;
            tx.commit().await.map_err(StoreError::database(CHANGE))?;
        }
        let mut tx = self.write().await?;
        audit(&mut tx, "admin", "rows known", name, &format!("{} episodes", known.new)).await?;
        tx.commit().await.map_err(StoreError::database(CHANGE))?;
        Ok(known)
    }

    /// Submissions of a version of the service that did not know rows, oldest first.
    pub(crate) async fn next_unindexed(&self) -> Result<Option<SubmissionId>, StoreError> {
        let row = sqlx::query(
            "SELECT id FROM submissions WHERE state IN ('graded', 'verified') AND indexed IS NULL \
             ORDER BY received, id LIMIT 1",
        )
        .fetch_optional(&self.database.pool)
        .await
        .map_err(StoreError::database(ASK))?;
        row.map(|row| super::submissions::id_of(&row, "id")).transpose()
    }

    /// Digests of the bags of a submission's episodes.
    pub(crate) async fn bags(&self, id: SubmissionId) -> Result<Vec<Digest>, StoreError> {
        let failed = |error| StoreError::database(ASK)(error);
        let rows = sqlx::query(
            "SELECT f.sha256 FROM episodes e JOIN files f ON f.submission = e.submission AND f.place = e.place \
             WHERE e.submission = $1 ORDER BY e.place",
        )
        .bind(id.to_string())
        .fetch_all(&self.database.pool)
        .await
        .map_err(failed)?;
        rows.iter().map(|row| super::submissions::digest_of(&row.try_get::<String, _>(0).map_err(failed)?)).collect()
    }

    /// Notes the rows of a graded submission as its own, unless another scorer grades now.
    pub(crate) async fn set_indexed(
        &self,
        term: Term,
        id: SubmissionId,
        account: &str,
        label: &Label,
        replaces: &BTreeSet<String>,
        rows: &[EpisodeRows],
    ) -> Result<(), StoreError> {
        let Some(mut tx) = self.write_on(term).await? else { return Ok(()) };
        own(&mut tx, id, account, label, replaces, rows).await?;
        tx.commit().await.map_err(StoreError::database(CHANGE))
    }

    /// Notes hosted runs in the journals of the board's servers. Runs that are known stay as they are.
    pub(crate) async fn know_runs(&self, runs: &[HostedRun]) -> Result<(), StoreError> {
        let failed = |error| StoreError::database("take runs")(error);
        let mut tx = self.write().await?;
        for run in runs {
            let text = serde_json::to_string(run).map_err(|error| StoreError::corrupt("a run", error))?;
            sqlx::query(
                "INSERT INTO hosted_runs (server, run, registration) VALUES ($1, $2, $3) ON CONFLICT DO NOTHING",
            )
            .bind(&run.server)
            .bind(&run.run)
            .bind(text)
            .execute(&mut *tx)
            .await
            .map_err(failed)?;
        }
        tx.commit().await.map_err(failed)
    }

    pub(crate) async fn runs(&self) -> Result<RunsInputs, StoreError> {
        let failed = |error| StoreError::database("be asked for runs")(error);
        let rows = sqlx::query("SELECT registration FROM hosted_runs ORDER BY server, run")
            .fetch_all(&self.database.pool)
            .await;
        let read = |row: &Row| {
            let text: String = row.try_get("registration").map_err(failed)?;
            serde_json::from_str(&text).map_err(|error| StoreError::corrupt("a run", error))
        };
        let runs = rows.map_err(failed)?.iter().map(read).collect::<Result<Vec<HostedRun>, _>>()?;
        let rows =
            sqlx::query("SELECT facts FROM submissions WHERE state IN ('graded', 'verified') AND facts IS NOT NULL");
        let mut shown = BTreeSet::new();
        // Without a run nothing is compared with it.
        if !runs.is_empty() {
            for row in rows.fetch_all(&self.database.pool).await.map_err(failed)? {
                let facts = facts_in(&row.try_get::<String, _>("facts").map_err(failed)?)?;
                if facts.hosted {
                    shown.extend(facts.runs);
                }
            }
        }
        Ok(RunsInputs { runs, shown })
    }
}

/// Gives the rows of a submission to it, and takes the submissions that it replaces out of the tables. A verified one stays until
/// this one is verified, too: a bad submission does not cost its account a good one.
pub(super) async fn own(
    tx: &mut Tx,
    id: SubmissionId,
    account: &str,
    label: &Label,
    replaces: &BTreeSet<String>,
    rows: &[EpisodeRows],
) -> Result<(), StoreError> {
    let own = id.to_string();
    let is_ready = is_verified(tx, &own).await?;
    let mut later = Vec::new();
    for other in replaces.iter().filter(|other| **other != own) {
        if !is_ready && is_verified(tx, other).await? {
            later.push(other.as_str());
        } else {
            replace(tx, other, id).await?;
        }
    }
    know(tx, &own, account, label, false, rows).await?;
    sqlx::query("UPDATE submissions SET indexed = $2, replaces = $3 WHERE id = $1")
        .bind(&own)
        .bind(now_ms())
        .bind(later.join(" "))
        .execute(&mut **tx)
        .await
        .map(drop)
        .map_err(StoreError::database(CHANGE))
}

/// Gives a submission that was verified the place of those that it replaces. Its rows are noted as its own by the next look.
pub(super) async fn take_place(tx: &mut Tx, id: SubmissionId) -> Result<(), StoreError> {
    let failed = |error| StoreError::database(CHANGE)(error);
    let row = sqlx::query("SELECT replaces FROM submissions WHERE id = $1").bind(id.to_string());
    let replaces = row.fetch_one(&mut **tx).await.map_err(failed)?.try_get::<Option<String>, _>("replaces");
    let replaces = replaces.map_err(failed)?.unwrap_or_default();
    if replaces.is_empty() {
        return Ok(());
    }
    for other in replaces.split(' ') {
        replace(tx, other, id).await?;
    }
    sqlx::query("UPDATE submissions SET indexed = NULL, replaces = NULL WHERE id = $1")
        .bind(id.to_string())
        .execute(&mut **tx)
        .await
        .map(drop)
        .map_err(failed)
}

async fn is_verified(tx: &mut Tx, id: &str) -> Result<bool, StoreError> {
    let row = sqlx::query("SELECT 1 FROM submissions WHERE id = $1 AND state = 'verified'").bind(id);
    let row = row.fetch_optional(&mut **tx).await.map_err(StoreError::database(ASK))?;
    Ok(row.is_some())
}

async fn replace(tx: &mut Tx, other: &str, by: SubmissionId) -> Result<(), StoreError> {
    let other: SubmissionId = other.parse().map_err(|error| StoreError::corrupt(format!("the id '{other}'"), error))?;
    let reason = format!("replaced by {by}, a later submission of the same episodes");
    super::submissions::refuse(tx, other, "service", &reason).await
}

/// Adds rows that are not known yet; returns their number.
async fn know(
    tx: &mut Tx,
    first: &str,
    account: &str,
    label: &Label,
    person: bool,
    rows: &[EpisodeRows],
) -> Result<u64, StoreError> {
    let mut count = 0;
    for EpisodeRows { task, seed, digest } in rows {
        let done = sqlx::query(
            "INSERT INTO known_rows (rows, task, seed, submission, account, policy, senses, person, at) \
             VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9) ON CONFLICT DO NOTHING",
        )
        .bind(digest)
        .bind(task)
        .bind(seed.to_string())
        .bind(first)
        .bind(account)
        .bind(&label.policy)
        .bind(&label.senses)
        .bind(i64::from(person))
        .bind(now_ms())
        .execute(&mut **tx)
        .await
        .map_err(StoreError::database(CHANGE))?;
        count += done.rows_affected();
    }
    Ok(count)
}

fn known_row(row: &Row, said: (String, u64)) -> Result<KnownRow, sqlx::Error> {
    Ok(KnownRow {
        task: row.try_get("task")?,
        seed: row.try_get("seed")?,
        first: row.try_get("submission")?,
        account: row.try_get("account")?,
        label: Label { policy: row.try_get("policy")?, senses: row.try_get("senses")? },
        person: row.try_get::<i64, _>("person")? != 0,
        said,
    })
}
