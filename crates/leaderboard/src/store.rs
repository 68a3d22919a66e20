//! The service's store: submissions, their results and bags, accounts, jobs.

mod accounts;
mod adopt;
mod blobs;
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
use std::time::Duration;

use fiatlux_grading::Results;
use sqlx::sqlite::{SqliteConnectOptions, SqliteJournalMode, SqlitePool, SqlitePoolOptions, SqliteSynchronous};
use sqlx::{Sqlite, Transaction};
use time::OffsetDateTime;

use crate::{Entry, StoreError, SubmissionId};
pub use accounts::{Account, AuditRow, TokenRow};
pub(crate) use blobs::{Blobs, Digest};
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

const DATABASE: &str = "leaderboard.sqlite";
const BLOBS: &str = "blobs";
const INCOMING: &str = "incoming";

/// Time for which a statement waits for another process, such as an admin command.
const BUSY: Duration = Duration::from_secs(20);
/// Number of connections that read the database. One more writes.
const READERS: u32 = 8;
const MAX_RESULTS: usize = 256;

/// The folder of a service: a database, the bags by their content, and incomplete uploads.
#[derive(Debug, Clone)]
pub struct Store {
    folder: PathBuf,
    pool: SqlitePool,
    /// It has one connection: writers wait for it here, and not in SQLite with a connection that others could read
    /// with.
    writer: SqlitePool,
    pub(crate) blobs: Blobs,
    results: Arc<Mutex<BTreeMap<SubmissionId, Arc<Results>>>>,
}

impl Store {
    /// Opens the folder; creates what is missing, and upgrades the database to this version.
    pub async fn open(folder: &Path) -> Result<Self, StoreError> {
        for folder in [folder.to_path_buf(), folder.join(INCOMING)] {
            std::fs::create_dir_all(&folder).map_err(StoreError::io("make", &folder))?;
        }
        let options = SqliteConnectOptions::new()
            .filename(folder.join(DATABASE))
            .create_if_missing(true)
            .foreign_keys(true)
            .journal_mode(SqliteJournalMode::Wal)
            // When a request is answered, its data must be on disk.
            .synchronous(SqliteSynchronous::Full)
            .busy_timeout(BUSY);
        let open = |connections, options| SqlitePoolOptions::new().max_connections(connections).connect_with(options);
        let writer = open(1, options.clone()).await.map_err(StoreError::database("be opened"))?;
        if schema::version(&writer).await? < schema::KNOWN {
            let _alone = lock::alone(folder).await?;
            schema::migrate(&writer, schema::KNOWN).await?;
        }
        let pool = open(READERS, options).await.map_err(StoreError::database("be opened"))?;
        let blobs = Blobs::open(&folder.join(BLOBS))?;
        let store = Self { folder: folder.into(), pool, writer, blobs, results: Arc::default() };
        store.adopt().await?;
        Ok(store)
    }

    /// Opens the folder of a service, but creates none.
    ///
    /// # Errors
    /// As for [`Store::open`]; [`StoreError::Nothing`]: the folder has no database.
    pub async fn open_existing(folder: &Path) -> Result<Self, StoreError> {
        if !folder.join(DATABASE).is_file() {
            return Err(StoreError::Nothing { folder: folder.into() });
        }
        Self::open(folder).await
    }

    /// Removes partial bags that were being written when a service was killed; returns their number. Nothing may write bags
    /// meanwhile: [`Store::join`] does it when nobody else is there.
    pub async fn remove_halves(&self) -> Result<usize, StoreError> {
        self.blobs.remove_staged().await
    }

    /// Checks that the database answers.
    pub async fn ping(&self) -> Result<(), StoreError> {
        sqlx::query("SELECT 1").execute(&self.pool).await.map(drop).map_err(StoreError::database("answer"))
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
        Ok(self.bag_digest(id, task, seed, episode).await?.map(|digest| self.blobs.local(&digest)))
    }

    /// Copies database and files into another folder, while the service runs; a service can be started on the copy. Files that
    /// the copy has already are kept; incomplete uploads are left out. Returns the number of new files, and their bytes.
    pub async fn backup(&self, to: &Path) -> Result<(u64, u64), StoreError> {
        std::fs::create_dir_all(to).map_err(StoreError::io("make", to))?;
        let fresh = to.join("leaderboard.sqlite.new");
        // Left by an interrupted backup.
        drop(std::fs::remove_file(&fresh));
        sqlx::query("VACUUM INTO $1")
            .bind(fresh.to_string_lossy().into_owned())
            .execute(&self.pool)
            .await
            .map_err(StoreError::database("be copied"))?;
        let target = to.join(DATABASE);
        for old in ["-wal", "-shm"].map(|end| to.join(format!("{DATABASE}{end}"))) {
            drop(std::fs::remove_file(old));
        }
        std::fs::rename(&fresh, &target).map_err(StoreError::io("write", &target))?;
        // The files that the copy of the database names, not those added since.
        let copy = Self::open(to).await?;
        let (mut files, mut bytes) = (0, 0);
        for digest in copy.contents().await? {
            if copy.blobs.has(&digest).await? {
                continue;
            }
            let from = self.blobs.local(&digest);
            if !copy.blobs.put_checked(&digest, &from).await? {
                return Err(StoreError::corrupt(
                    from.display().to_string(),
                    "its content does not match the digest in its name",
                ));
            }
            files += 1;
            bytes += from.metadata().map_or(0, |data| data.len());
        }
        copy.pool.close().await;
        copy.writer.close().await;
        Ok((files, bytes))
    }

    pub(crate) fn incoming(&self, id: SubmissionId) -> PathBuf {
        self.folder.join(INCOMING).join(id.to_string())
    }

    /// Folder with the files of a submission under their own names, while it is graded.
    pub(crate) fn work(&self, id: SubmissionId) -> PathBuf {
        self.folder.join(INCOMING).join(format!("{id}-graded"))
    }

    /// A transaction that writes from its first statement: SQLite cannot turn a reader into a writer without races.
    async fn write(&self) -> Result<Transaction<'static, Sqlite>, StoreError> {
        self.writer.begin_with("BEGIN IMMEDIATE").await.map_err(StoreError::database("be locked"))
    }
}

pub(crate) fn now_ms() -> i64 {
    (OffsetDateTime::now_utc().unix_timestamp_nanos() / 1_000_000) as i64
}

/// A time from the database, ms since 1970.
fn moment(ms: i64) -> OffsetDateTime {
    OffsetDateTime::from_unix_timestamp_nanos(i128::from(ms) * 1_000_000).unwrap_or(OffsetDateTime::UNIX_EPOCH)
}
