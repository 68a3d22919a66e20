//! The rows of a bag as one digest, whatever its header says.
//!
//! The digest of an episode is bound to its task, seed and conditions, so the same rows under a changed header have another
//! one. This one starts from nothing: equal rows are found again under any header.

use std::path::Path;

use fiatlux_bag::{Bag, BagError, Patience};
use fiatlux_proto::v3::EpisodeHeader;
use fiatlux_rules::RowDigest;
use fiatlux_wire::{WireError, layout_of, read_row};
use thiserror::Error;

use crate::conditions::is_person;

/// The rows of one bag, and what its header says of them.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BagRows {
    /// As the header has it, such as `S05`.
    pub task: String,
    pub seed: u64,
    /// SHA-256 chain over the rows alone, hexadecimal.
    pub digest: String,
    pub policy: String,
    /// The bag says that a person drove.
    pub person: bool,
}

/// The rows of a bag cannot be read.
#[derive(Debug, Error)]
pub enum RowsError {
    #[error(transparent)]
    Bag(#[from] BagError),
    #[error(transparent)]
    Row(#[from] WireError),
}

/// The start of a chain over rows alone.
pub(crate) fn chain() -> RowDigest {
    RowDigest::new(b"rows alone")
}

/// Reads all rows of a bag, without judging them.
///
/// # Errors
/// The bag, or one of its rows, cannot be read.
pub fn rows_of(path: &Path, patience: Option<Patience>) -> Result<BagRows, RowsError> {
    let bag = Bag::open(path)?.with_patience(patience);
    let header: &EpisodeHeader = bag.header();
    let layout = layout_of(header)?;
    let mut digest = chain();
    let mut states = bag.states();
    while let Some(state) = states.next() {
        let state = state?;
        let row = read_row(&state, layout)?;
        states.reuse(state);
        digest.push(&row);
    }
    Ok(BagRows {
        task: header.task.clone(),
        seed: header.seed,
        digest: digest.hex(),
        policy: header.policy.clone(),
        person: is_person(header),
    })
}
