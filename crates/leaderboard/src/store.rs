//! The service's store: submissions, their results and bags, accounts, jobs.

mod accounts;
mod adopt;
mod blobs;
mod bucket;
mod copy;
mod database;
mod facts;
mod known;
mod lease;
mod lock;
mod pictures;
pub(crate) mod queue;
mod schema;
mod scorers;
mod submissions;
mod summaries;
mod thin;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use fiatlux_grading::Results;
use time::OffsetDateTime;

use crate::{Entry, StoreError, SubmissionId};
pub use accounts::{Account, AuditRow, TokenRow};
pub use blobs::FilesUrl;
pub(crate) use blobs::{Blobs, Digest};
pub use database::DatabaseUrl;
use database::{Database, Tx};
pub(crate) use known::EpisodeRows;
pub use known::KnownBags;
pub(crate) use lease::LEASE;
pub(crate) use pictures::{Picture, Pictures};
pub use queue::Verdict;
pub(crate) use queue::{EpisodeJob, EpisodePlan, Graded, Return};
pub use scorers::Joined;
pub(crate) use scorers::{Duty, Term};
pub(crate) use submissions::{BeginOutcome, Draft, StoredFile};
pub use submissions::{Count, FileRow};
pub use thin::ThinnedBags;

const BLOBS: &str = "blobs";
const COPIES: &str = "copies";
const INCOMING: &str = "incoming";
const MAX_RESULTS: usize = 256;

/// Where a service keeps everything.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Place {
    /// Incomplete uploads, and copies of a bucket's files, are here.
    pub folder: PathBuf,
    pub database: DatabaseUrl,
    pub files: FilesUrl,
}

impl Place {
    /// Database and files in one folder.
    pub fn folder(folder: &Path) -> Self {
        let files = FilesUrl::Folder(folder.join(BLOBS));
        Self { folder: folder.into(), database: DatabaseUrl::in_folder(folder), files }
    }
}

/// The store of a service: a database, the bags by their content, and incomplete uploads.
#[derive(Debug, Clone)]
pub struct Store {
    place: Place,
    database: Database,
    pub(crate) blobs: Blobs,
    results: Arc<Mutex<BTreeMap<SubmissionId, Arc<Results>>>>,
}

impl Store {
    /// Opens the store of a folder.
    ///
    /// # Errors
    /// As for [`Store::open_at`].
    pub async fn open(folder: &Path) -> Result<Self, StoreError> {
        Self::open_at(&Place::folder(folder)).await
    }

    /// Opens a store; creates what is missing but a database of PostgreSQL and a bucket, and upgrades the tables to this version.
    pub async fn open_at(place: &Place) -> Result<Self, StoreError> {
        for folder in [place.folder.clone(), place.folder.join(INCOMING)] {
            std::fs::create_dir_all(&folder).map_err(StoreError::io("make", &folder))?;
        }
        let database = schema::open(&place.database).await?;
        let blobs = Blobs::open(&place.files, &place.folder.join(COPIES)).await?;
        let store = Self { place: place.clone(), database, blobs, results: Arc::default() };
        store.adopt().await?;
        Ok(store)
    }

    /// Opens a store that somebody has made.
    ///
    /// # Errors
    /// As for [`Store::open_at`]; [`StoreError::Nothing`]: the database has no leaderboard.
    pub async fn open_existing(place: &Place) -> Result<Self, StoreError> {
        if !Database::exists(&place.database).await? {
            return Err(StoreError::Nothing { store: place.database.to_string() });
        }
        Self::open_at(place).await
    }

    /// Removes partial bags that were being written when a service was killed; returns their number. Nothing may write bags
    /// meanwhile: [`Store::join`] does it when nobody else is there.
    pub async fn remove_halves(&self) -> Result<usize, StoreError> {
        self.blobs.remove_staged().await
    }

    /// Checks that the database answers.
    pub async fn ping(&self) -> Result<(), StoreError> {
        sqlx::query("SELECT 1").execute(&self.database.pool).await.map(drop).map_err(StoreError::database("answer"))
    }

    /// Every submission that is graded or verified, oldest first.
    pub async fn entries(&self) -> Result<Vec<Entry>, StoreError> {
        self.listed().await
    }

    /// A submission in any state.
    pub async fn entry(&self, id: SubmissionId) -> Result<Option<Entry>, StoreError> {
        self.one(id).await
    }

    /// The results of a submission; `None` if it does not exist or is not graded yet.
    pub async fn results(&self, id: SubmissionId) -> Result<Option<Arc<Results>>, StoreError> {
        let known = || self.results.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(found) = known().get(&id) {
            return Ok(Some(Arc::clone(found)));
        }
        let Some(digest) = self.results_digest(id).await? else { return Ok(None) };
        let bytes = self.blobs.read(&digest).await?;
        let corrupt =
            |error: &dyn ToString| StoreError::corrupt(format!("results.json of submission {id}"), error.to_string());
        // Megabytes for a submission with many episodes.
        let read = tokio::task::spawn_blocking(move || serde_json::from_slice::<Results>(&bytes));
        let results = read.await.map_err(|error| corrupt(&error))?.map_err(|error| corrupt(&error))?;
        let results = Arc::new(results);
        let mut known = known();
        if known.len() >= MAX_RESULTS {
            known.pop_first();
        }
        known.insert(id, Arc::clone(&results));
        Ok(Some(results))
    }

    fn forget_results(&self, id: SubmissionId) {
        self.results.lock().unwrap_or_else(PoisonError::into_inner).remove(&id);
    }

    /// Path of an episode's bag, a local file whose digest was checked when it was uploaded. `None` if the submission
    /// has no such episode, or if the episode counts as a failure without a bag.
    pub async fn bag(
        &self,
        id: SubmissionId,
        task: &str,
        seed: u64,
        episode: u64,
    ) -> Result<Option<PathBuf>, StoreError> {
        match self.bag_digest(id, task, seed, episode).await? {
            Some(digest) => self.blobs.local(&digest).await.map(Some),
            None => Ok(None),
        }
    }

    pub(crate) fn incoming(&self, id: SubmissionId) -> PathBuf {
        self.place.folder.join(INCOMING).join(id.to_string())
    }

    /// Folder with the files of a submission under their own names, while it is graded.
    pub(crate) fn work(&self, id: SubmissionId) -> PathBuf {
        self.place.folder.join(INCOMING).join(format!("{id}-graded"))
    }

    async fn write(&self) -> Result<Tx, StoreError> {
        self.database.write().await
    }

    /// The store of a test: that of a folder, or one on PostgreSQL. Its files are none that a bucket would take, so they are in the folder.
    #[cfg(test)]
    pub(crate) async fn of_test(folder: &Path) -> Result<Self, StoreError> {
        let mut place = Place::folder(folder);
        if let Some((database, _)) = crate::stores::addresses(folder) {
            place.database =
                database.parse().map_err(|error: String| StoreError::corrupt("the address of a test", error))?;
        }
        Self::open_at(&place).await
    }
}

pub(crate) fn now_ms() -> i64 {
    (OffsetDateTime::now_utc().unix_timestamp_nanos() / 1_000_000) as i64
}

/// A time from the database, ms since 1970.
fn moment(ms: i64) -> OffsetDateTime {
    OffsetDateTime::from_unix_timestamp_nanos(i128::from(ms) * 1_000_000).unwrap_or(OffsetDateTime::UNIX_EPOCH)
}
