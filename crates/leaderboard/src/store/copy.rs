//! Copies of a whole store in another place, of either kind: backups and moves.

use std::future::poll_fn;
use std::path::{Path, PathBuf};
use std::time::Duration;

use sqlx::{AssertSqlSafe, Column as _, Row as _};

use super::database::Database;
use super::{Blobs, DatabaseUrl, Digest, Place, Store, schema};
use crate::StoreError;

/// All tables with rows that a copy needs, each after those that it refers to. `duties` are of those who work on a store.
const TABLES: [&str; 10] = [
    "accounts",
    "tokens",
    "audit",
    "submissions",
    "files",
    "episodes",
    "pictures",
    "known_rows",
    "hosted_runs",
    "summaries",
];

/// A scorer that was just stopped lets go of a database within so long.
const LEAVES: Duration = Duration::from_secs(5);
const READ: &str = "be read";
const WRITE: &str = "be copied";

/// Number of new files of a copy, and their bytes.
pub type Copied = (u64, u64);

impl Store {
    /// Copies database and files into a folder, while services run on them; a service can be started on the copy. Files that the
    /// copy has already are kept; incomplete uploads are left out.
    pub async fn backup(&self, to: &Path) -> Result<Copied, StoreError> {
        std::fs::create_dir_all(to).map_err(StoreError::io("make", to))?;
        let place = Place::folder(to);
        let DatabaseUrl::Sqlite(target) = &place.database else {
            return Err(StoreError::Taken { store: to.display().to_string() });
        };
        let fresh = to.join("leaderboard.sqlite.new");
        let sides = |file: &Path| {
            ["", "-wal", "-shm"].map(|end| {
                let mut name = file.as_os_str().to_owned();
                name.push(end);
                PathBuf::from(name)
            })
        };
        // Left by an interrupted backup.
        for file in sides(&fresh) {
            drop(std::fs::remove_file(file));
        }
        let url = DatabaseUrl::Sqlite(fresh.clone());
        let copy = schema::open(&url).await?;
        self.copy_rows(&copy).await?;
        // Into one file.
        sqlx::raw_sql("PRAGMA journal_mode = DELETE")
            .execute(&copy.writer)
            .await
            .map_err(StoreError::database(WRITE))?;
        copy.close().await;
        for file in sides(target) {
            drop(std::fs::remove_file(file));
        }
        std::fs::rename(&fresh, target).map_err(StoreError::io("write", target))?;
        let copy = Self::open_at(&place).await?;
        // The files that the copy of the database names, and not those added since.
        let copied = self.copy_files(&copy, &copy).await?;
        copy.database.close().await;
        Ok(copied)
    }

    /// Copies everything to a new place, where services go on; one that was interrupted may be repeated. No scorer may run on this
    /// store, and incomplete uploads start again. Nothing here is removed.
    pub async fn move_to(&self, place: &Place) -> Result<Copied, StoreError> {
        let in_use = || StoreError::InUse { store: self.place.database.to_string() };
        let _alone = self.database.held(true, LEAVES).await?.ok_or_else(in_use)?;
        let to = Self::open_at(place).await?;
        if !to.list_audit(1).await?.is_empty() {
            return Err(StoreError::Taken { store: place.database.to_string() });
        }
        // Files first: a row never names a file that is not there.
        let copied = self.copy_files(self, &to).await?;
        self.copy_rows(&to.database).await?;
        Ok(copied)
    }

    async fn copy_files(&self, named_by: &Store, to: &Store) -> Result<Copied, StoreError> {
        let (mut files, mut bytes) = (0, 0);
        for digest in named_by.contents().await? {
            if to.blobs.has(&digest).await? {
                continue;
            }
            bytes += copy_file(&self.blobs, &to.blobs, &digest).await?;
            files += 1;
        }
        Ok((files, bytes))
    }

    /// Copies the rows of one moment into new tables.
    async fn copy_rows(&self, to: &Database) -> Result<(), StoreError> {
        let (read, write) = (|error| StoreError::database(READ)(error), |error| StoreError::database(WRITE)(error));
        let mut from = self.database.snapshot().await?;
        let mut tx = to.write().await?;
        for table in TABLES {
            let select = AssertSqlSafe(format!("SELECT * FROM {table}"));
            let mut rows = sqlx::query(select).fetch(&mut *from);
            while let Some(row) = poll_fn(|context| rows.as_mut().poll_next(context)).await {
                let row = row.map_err(read)?;
                let names: Vec<&str> = row.columns().iter().map(|column| column.name()).collect();
                let places: Vec<String> = (1..=names.len()).map(|place| format!("${place}")).collect();
                let insert = format!("INSERT INTO {table} ({}) VALUES ({})", names.join(", "), places.join(", "));
                let mut query = sqlx::query(AssertSqlSafe(insert));
                for column in row.columns() {
                    query = if column.type_info().kind().is_integer() {
                        query.bind(row.try_get::<Option<i64>, _>(column.ordinal()).map_err(read)?)
                    } else {
                        query.bind(row.try_get::<Option<String>, _>(column.ordinal()).map_err(read)?)
                    };
                }
                query.execute(&mut *tx).await.map_err(write)?;
            }
        }
        let counted = "UPDATE counters SET value = (SELECT COALESCE(MAX(a.seq), 0) FROM audit a) WHERE name = 'audit'";
        sqlx::query(counted).execute(&mut *tx).await.map_err(write)?;
        tx.commit().await.map_err(write)
    }
}

/// Copies a file, whose content is checked on the way; returns its bytes.
async fn copy_file(from: &Blobs, to: &Blobs, digest: &Digest) -> Result<u64, StoreError> {
    let path = from.local(digest).await?;
    if !to.put_checked(digest, &path).await? {
        let what = path.display().to_string();
        return Err(StoreError::corrupt(what, "its content does not match the digest in its name"));
    }
    Ok(path.metadata().map_or(0, |data| data.len()))
}
