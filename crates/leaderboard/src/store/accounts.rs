//! Accounts, their tokens, and the audit log.

use sqlx::Row as _;

use super::database::{Row, Tx};
use super::{Store, now_ms};
use crate::StoreError;

/// The holder of tokens, with the limits on its submissions.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Account {
    /// Letters, digits, `-` and `_`.
    pub name: String,
    pub created_ms: i64,
    /// The tokens of a closed account are refused.
    pub closed_ms: Option<i64>,
    /// Maximum number of submissions begun within 24 hours.
    pub submissions_a_day: i64,
    /// Maximum size of all its submissions together, bytes.
    pub max_bytes: i64,
}

/// A token in the store: its digest, never the token itself. Times are ms since 1970.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TokenRow {
    /// Its public part, 16 hexadecimal digits.
    pub id: String,
    pub account: String,
    /// SHA-256 of the whole token, hexadecimal.
    pub sha256: String,
    pub created_ms: i64,
    pub expires_ms: i64,
    pub revoked_ms: Option<i64>,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AuditRow {
    pub seq: i64,
    pub at_ms: i64,
    /// `admin`, `service`, or an account.
    pub who: String,
    pub action: String,
    /// An account, the id of a token, or a submission.
    pub subject: String,
    pub detail: String,
}

const ACCOUNT: &str = "be asked for an account";
const TOKEN: &str = "be asked for a token";

impl Store {
    /// Adds an account; returns `false` if the name is taken.
    pub(crate) async fn add_account(&self, account: &Account) -> Result<bool, StoreError> {
        let mut tx = self.write().await?;
        let done = sqlx::query(
            "INSERT INTO accounts (name, created, submissions_a_day, max_bytes) VALUES ($1, $2, $3, $4) \
             ON CONFLICT DO NOTHING",
        )
        .bind(&account.name)
        .bind(account.created_ms)
        .bind(account.submissions_a_day)
        .bind(account.max_bytes)
        .execute(&mut *tx)
        .await
        .map_err(StoreError::database("take an account"))?;
        let limits = format!("{} a day, {} bytes", account.submissions_a_day, account.max_bytes);
        let is_new = done.rows_affected() == 1;
        if is_new {
            audit(&mut tx, "admin", "account made", &account.name, &limits).await?;
        }
        tx.commit().await.map_err(StoreError::database("take an account"))?;
        Ok(is_new)
    }

    /// Sets an account's limits, and closes or opens it; returns `false` if there is no such account.
    pub(crate) async fn change_account(&self, account: &Account) -> Result<bool, StoreError> {
        let mut tx = self.write().await?;
        let done =
            sqlx::query("UPDATE accounts SET closed = $2, submissions_a_day = $3, max_bytes = $4 WHERE name = $1")
                .bind(&account.name)
                .bind(account.closed_ms)
                .bind(account.submissions_a_day)
                .bind(account.max_bytes)
                .execute(&mut *tx)
                .await
                .map_err(StoreError::database("change an account"))?;
        let closed = if account.closed_ms.is_some() { ", closed" } else { "" };
        let limits = format!("{} a day, {} bytes{closed}", account.submissions_a_day, account.max_bytes);
        audit(&mut tx, "admin", "account changed", &account.name, &limits).await?;
        tx.commit().await.map_err(StoreError::database("change an account"))?;
        Ok(done.rows_affected() == 1)
    }

    pub(crate) async fn account(&self, name: &str) -> Result<Option<Account>, StoreError> {
        let row =
            sqlx::query("SELECT * FROM accounts WHERE name = $1").bind(name).fetch_optional(&self.database.pool).await;
        row.map_err(StoreError::database(ACCOUNT))?.map(|row| account_of(&row)).transpose()
    }

    pub(crate) async fn accounts(&self) -> Result<Vec<Account>, StoreError> {
        let rows = sqlx::query("SELECT * FROM accounts ORDER BY name").fetch_all(&self.database.pool).await;
        rows.map_err(StoreError::database(ACCOUNT))?.iter().map(account_of).collect()
    }

    /// Stores a new token, and notes it in the audit log.
    pub(crate) async fn add_token(&self, token: &TokenRow) -> Result<(), StoreError> {
        let failed = |error| StoreError::database("take a token")(error);
        let mut tx = self.write().await?;
        sqlx::query("INSERT INTO tokens (id, account, sha256, created, expires) VALUES ($1, $2, $3, $4, $5)")
            .bind(&token.id)
            .bind(&token.account)
            .bind(&token.sha256)
            .bind(token.created_ms)
            .bind(token.expires_ms)
            .execute(&mut *tx)
            .await
            .map_err(failed)?;
        audit(&mut tx, "admin", "token made", &token.id, &token.account).await?;
        tx.commit().await.map_err(failed)
    }

    pub(crate) async fn token(&self, id: &str) -> Result<Option<TokenRow>, StoreError> {
        let row = sqlx::query("SELECT * FROM tokens WHERE id = $1").bind(id).fetch_optional(&self.database.pool).await;
        row.map_err(StoreError::database(TOKEN))?.map(|row| token_of(&row)).transpose()
    }

    /// An account's tokens, oldest first.
    pub(crate) async fn tokens(&self, account: &str) -> Result<Vec<TokenRow>, StoreError> {
        let rows = sqlx::query("SELECT * FROM tokens WHERE account = $1 ORDER BY created, id")
            .bind(account)
            .fetch_all(&self.database.pool)
            .await;
        rows.map_err(StoreError::database(TOKEN))?.iter().map(token_of).collect()
    }

    /// Revokes a token for good; returns `false` if there is none, or if it was revoked before.
    pub(crate) async fn revoke(&self, id: &str) -> Result<bool, StoreError> {
        let failed = |error| StoreError::database("revoke a token")(error);
        let mut tx = self.write().await?;
        let done = sqlx::query("UPDATE tokens SET revoked = $2 WHERE id = $1 AND revoked IS NULL")
            .bind(id)
            .bind(now_ms())
            .execute(&mut *tx)
            .await
            .map_err(failed)?;
        let is_done = done.rows_affected() == 1;
        if is_done {
            audit(&mut tx, "admin", "token revoked", id, "").await?;
        }
        tx.commit().await.map_err(failed)?;
        Ok(is_done)
    }

    /// The last lines of the audit log, newest last.
    pub(crate) async fn audit_log(&self, most: i64) -> Result<Vec<AuditRow>, StoreError> {
        let failed = |error| StoreError::database("be asked for the audit log")(error);
        let rows = sqlx::query("SELECT * FROM audit ORDER BY seq DESC LIMIT $1")
            .bind(most)
            .fetch_all(&self.database.pool)
            .await;
        let mut rows = rows.map_err(failed)?;
        rows.reverse();
        let row_of = |row: &Row| {
            Ok(AuditRow {
                seq: row.try_get("seq")?,
                at_ms: row.try_get("at")?,
                who: row.try_get("who")?,
                action: row.try_get("action")?,
                subject: row.try_get("subject")?,
                detail: row.try_get("detail")?,
            })
        };
        rows.iter().map(row_of).collect::<Result<_, _>>().map_err(failed)
    }
}

fn account_of(row: &Row) -> Result<Account, StoreError> {
    let read = || {
        Ok(Account {
            name: row.try_get("name")?,
            created_ms: row.try_get("created")?,
            closed_ms: row.try_get("closed")?,
            submissions_a_day: row.try_get("submissions_a_day")?,
            max_bytes: row.try_get("max_bytes")?,
        })
    };
    read().map_err(StoreError::database(ACCOUNT))
}

fn token_of(row: &Row) -> Result<TokenRow, StoreError> {
    let read = || {
        Ok(TokenRow {
            id: row.try_get("id")?,
            account: row.try_get("account")?,
            sha256: row.try_get("sha256")?,
            created_ms: row.try_get("created")?,
            expires_ms: row.try_get("expires")?,
            revoked_ms: row.try_get("revoked")?,
        })
    };
    read().map_err(StoreError::database(TOKEN))
}

/// Writes a line to the audit log, in the transaction of the change that it records.
pub(super) async fn audit(tx: &mut Tx, who: &str, action: &str, subject: &str, detail: &str) -> Result<(), StoreError> {
    let failed = |error| StoreError::database("write the audit log")(error);
    // Whoever writes next waits for this row until the transaction ends. So the log has no gap, and nobody's number is taken.
    let row = sqlx::query("UPDATE counters SET value = value + 1 WHERE name = 'audit' RETURNING value");
    let seq: i64 = row.fetch_one(&mut **tx).await.and_then(|row| row.try_get("value")).map_err(failed)?;
    sqlx::query("INSERT INTO audit (seq, at, who, action, subject, detail) VALUES ($1, $2, $3, $4, $5, $6)")
        .bind(seq)
        .bind(now_ms())
        .bind(who)
        .bind(action)
        .bind(subject)
        .bind(detail)
        .execute(&mut **tx)
        .await
        .map(drop)
        .map_err(failed)
}
