//! The facts of a submission as the database stores them, and what it forgets with a submission.

use std::collections::BTreeSet;

use super::database::Tx;
use crate::StoreError;
use crate::claims::{Facts, HostedRun};

/// The inputs of [`crate::claims::tries_of`].
#[derive(Debug, Default)]
pub(crate) struct RunsInputs {
    pub runs: Vec<HostedRun>,
    /// Names of the runs of hosted entries.
    pub shown: BTreeSet<String>,
}

/// Forgets the rows of a submission that is in no table any more. Those of a person stay.
pub(super) async fn forget_rows(tx: &mut Tx, id: &str) -> Result<(), StoreError> {
    sqlx::query("DELETE FROM known_rows WHERE submission = $1 AND person = 0")
        .bind(id)
        .execute(&mut **tx)
        .await
        .map(drop)
        .map_err(StoreError::database("take known rows"))
}

pub(super) fn facts_in(text: &str) -> Result<Facts, StoreError> {
    serde_json::from_str(text).map_err(|error| StoreError::corrupt("the facts of a submission", error))
}

pub(super) fn facts_text(facts: &Facts) -> Result<String, StoreError> {
    serde_json::to_string(facts).map_err(|error| StoreError::corrupt("the facts of a submission", error))
}
