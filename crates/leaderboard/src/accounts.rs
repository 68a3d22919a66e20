//! Accounts and their tokens: permission to submit, and what an administrator can change.
//!
//! A token is `fiatlux_ID_SECRET`: 16 and 64 hexadecimal digits. The store keeps its SHA-256; the secret is 256 random
//! bits, so a digest gives nothing away and needs no salt.

use data_encoding::HEXLOWER;
use fiatlux_proto::keys::is_name;
use subtle::ConstantTimeEq as _;
use thiserror::Error;

use crate::store::{Account, AuditRow, Digest, TokenRow, now_ms};
use crate::{Entry, Store, StoreError, SubmissionId};

const PREFIX: &str = "fiatlux_";
const DAY_MS: i64 = 24 * 3600 * 1000;

pub const MAX_DAYS: u32 = 3650;

#[derive(Debug, Error)]
pub enum AccountError {
    #[error(transparent)]
    Store(#[from] StoreError),
    #[error("'{name}' cannot be the name of an account; use 1 to 64 letters, digits, - or _")]
    Name { name: String },
    #[error("the account '{name}' exists already; choose another name, or change it with `scorer admin change`")]
    Exists { name: String },
    #[error("there is no account '{name}'; `scorer admin accounts` lists all of them")]
    NoAccount { name: String },
    #[error("there is no token '{id}', or it is revoked already; `scorer admin accounts` lists all of them")]
    NoToken { id: String },
    #[error("there is no submission {id}; `scorer admin submissions` lists all of them")]
    NoSubmission { id: SubmissionId },
}

/// A request is refused. The message tells its sender nothing new about other accounts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub(crate) enum Denied {
    #[error("the request has no token; send the header Authorization: Bearer TOKEN")]
    Missing,
    #[error("this service did not issue the token; ask its administrator for one")]
    Wrong,
    #[error("the token has expired; ask the administrator for a new one")]
    Expired,
    #[error("the token was revoked; ask the administrator for a new one")]
    Revoked,
    #[error("the account is closed; ask the administrator")]
    Closed,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Quota {
    pub submissions_a_day: u32,
    /// Bytes of all its submissions together.
    pub max_bytes: u64,
}

impl Default for Quota {
    /// 20 submissions a day, 64 GiB.
    fn default() -> Self {
        Self { submissions_a_day: 20, max_bytes: 64 << 30 }
    }
}

impl Quota {
    fn bytes(self) -> i64 {
        i64::try_from(self.max_bytes).unwrap_or(i64::MAX)
    }
}

impl Store {
    pub async fn make_account(&self, name: &str, quota: Quota) -> Result<(), AccountError> {
        if !is_name(name) {
            return Err(AccountError::Name { name: name.into() });
        }
        let account = Account {
            name: name.into(),
            created_ms: now_ms(),
            closed_ms: None,
            submissions_a_day: quota.submissions_a_day.into(),
            max_bytes: quota.bytes(),
        };
        if self.add_account(&account).await? { Ok(()) } else { Err(AccountError::Exists { name: name.into() }) }
    }

    /// Sets the limits that are given, and closes the account or opens it again. The tokens of a closed account are refused;
    /// its submissions stay.
    pub async fn set_account(
        &self,
        name: &str,
        submissions_a_day: Option<u32>,
        max_bytes: Option<u64>,
        closed: bool,
    ) -> Result<(), AccountError> {
        let no_account = || AccountError::NoAccount { name: name.into() };
        let known = self.account(name).await?.ok_or_else(no_account)?;
        let account = Account {
            closed_ms: closed.then(|| known.closed_ms.unwrap_or_else(now_ms)),
            submissions_a_day: submissions_a_day.map_or(known.submissions_a_day, i64::from),
            max_bytes: max_bytes.map_or(known.max_bytes, |bytes| i64::try_from(bytes).unwrap_or(i64::MAX)),
            ..known
        };
        if self.change_account(&account).await? { Ok(()) } else { Err(no_account()) }
    }

    /// Creates a token that is valid for `days`, at most [`MAX_DAYS`]. The store keeps only its digest, so it must be
    /// shown now.
    pub async fn make_token(&self, account: &str, days: u32) -> Result<String, AccountError> {
        if self.account(account).await?.is_none() {
            return Err(AccountError::NoAccount { name: account.into() });
        }
        let mut random = [0; 40];
        getrandom::fill(&mut random).map_err(StoreError::Random)?;
        let hex: String = HEXLOWER.encode(&random);
        let (id, secret) = hex.split_at(16);
        let token = format!("{PREFIX}{id}_{secret}");
        let created_ms = now_ms();
        let row = TokenRow {
            id: id.into(),
            account: account.into(),
            sha256: Digest::of(token.as_bytes()).as_str().into(),
            created_ms,
            expires_ms: created_ms + i64::from(days.min(MAX_DAYS)) * DAY_MS,
            revoked_ms: None,
        };
        self.add_token(&row).await?;
        Ok(token)
    }

    /// Revokes a token at once and for good; `id` is the 16 digits after `fiatlux_`.
    pub async fn revoke_token(&self, id: &str) -> Result<(), AccountError> {
        if self.revoke(id).await? { Ok(()) } else { Err(AccountError::NoToken { id: id.into() }) }
    }

    /// All accounts, by name, each with its tokens, oldest first.
    pub async fn list_accounts(&self) -> Result<Vec<(Account, Vec<TokenRow>)>, StoreError> {
        let mut listed = Vec::new();
        for account in self.accounts().await? {
            let tokens = self.tokens(&account.name).await?;
            listed.push((account, tokens));
        }
        Ok(listed)
    }

    /// All submissions in any state, oldest first.
    pub async fn list_submissions(&self) -> Result<Vec<Entry>, StoreError> {
        self.every(None).await
    }

    /// The last lines of the audit log, newest last.
    pub async fn list_audit(&self, most: u32) -> Result<Vec<AuditRow>, StoreError> {
        self.audit_log(most.into()).await
    }

    /// Refuses a submission, which takes it out of all tables. Its bags stay.
    pub async fn refuse_submission(&self, id: SubmissionId, reason: &str) -> Result<(), AccountError> {
        if self.entry(id).await?.is_none() {
            return Err(AccountError::NoSubmission { id });
        }
        Ok(self.refuse(id, "admin", reason).await?)
    }

    /// Removes a submission and the bags that no other one uses. This cannot be undone; the submitter may send it again.
    pub async fn remove_submission(&self, id: SubmissionId) -> Result<(), AccountError> {
        if self.remove(id, "admin").await? { Ok(()) } else { Err(AccountError::NoSubmission { id }) }
    }

    /// The account of a token. Takes as long for a wrong secret as for the right one.
    pub(crate) async fn account_by(&self, token: Option<&str>) -> Result<Result<Account, Denied>, StoreError> {
        let Some(token) = token else { return Ok(Err(Denied::Missing)) };
        let Some(id) = id_in(token) else { return Ok(Err(Denied::Wrong)) };
        let Some(row) = self.token(id).await? else { return Ok(Err(Denied::Wrong)) };
        let digest = Digest::of(token.as_bytes());
        if !bool::from(digest.as_str().as_bytes().ct_eq(row.sha256.as_bytes())) {
            return Ok(Err(Denied::Wrong));
        }
        if row.revoked_ms.is_some() {
            return Ok(Err(Denied::Revoked));
        }
        if row.expires_ms <= now_ms() {
            return Ok(Err(Denied::Expired));
        }
        let Some(account) = self.account(&row.account).await? else { return Ok(Err(Denied::Wrong)) };
        Ok(if account.closed_ms.is_some() { Err(Denied::Closed) } else { Ok(account) })
    }
}

fn id_in(token: &str) -> Option<&str> {
    let (id, secret) = token.strip_prefix(PREFIX)?.split_once('_')?;
    let is_hex = |text: &str, length| text.len() == length && text.bytes().all(|byte| byte.is_ascii_hexdigit());
    (is_hex(id, 16) && is_hex(secret, 64)).then_some(id)
}
