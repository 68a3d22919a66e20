//! Old bags without their rows, which are simulated again where somebody asks for them.

use std::path::{Path, PathBuf};
use std::time::Duration;

use fiatlux_bag::{Bag, convert};
use fiatlux_cli::in_full;
use sqlx::Row as _;

use super::accounts::audit;
use super::lease::after;
use super::submissions::digest_of;
use super::{Digest, INCOMING, Store, now_ms};
use crate::StoreError;

const CHANGE: &str = "take thin bags";

/// Summary of what [`Store::thin`] changed.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct ThinnedBags {
    pub bags: u64,
    /// Bytes of these bags before and after.
    pub before: u64,
    pub after: u64,
    /// Bags that stayed as they were, with the reason.
    pub kept: Vec<String>,
}

/// A file that is removed when it is dropped.
struct Scratch(PathBuf);

impl Drop for Scratch {
    fn drop(&mut self) {
        drop(std::fs::remove_file(&self.0));
    }
}

impl Store {
    /// Makes the bags of verified submissions thin that were received longer ago than this. A bag stays full if its rows cannot be
    /// simulated again here, or if another submission that is younger or waits has it, too. May run while services do.
    pub async fn thin(&self, older: Duration) -> Result<ThinnedBags, StoreError> {
        let failed = |error| StoreError::database(CHANGE)(error);
        let before = now_ms() - after(0, older);
        let rows = sqlx::query(
            "SELECT DISTINCT f.sha256 FROM files f JOIN submissions s ON s.id = f.submission \
             WHERE f.stored = 1 AND f.name LIKE '%.mcap' AND s.state = 'verified' AND s.received <= $1 AND NOT EXISTS \
             (SELECT 1 FROM files o JOIN submissions p ON p.id = o.submission WHERE o.sha256 = f.sha256 \
             AND (p.state NOT IN ('verified', 'refused') OR p.received > $1)) ORDER BY f.sha256",
        )
        .bind(before)
        .fetch_all(&self.database.pool)
        .await
        .map_err(failed)?;
        let scratch = self.place.folder.join(INCOMING).join(format!("thin-{}", std::process::id()));
        let mut done = ThinnedBags::default();
        for row in &rows {
            let old = digest_of(&row.try_get::<String, _>("sha256").map_err(failed)?)?;
            let (from, to) = (self.blobs.local(&old).await?, scratch.clone());
            let size = from.metadata().map_or(0, |file| file.len());
            let made = tokio::task::spawn_blocking(move || thin_copy(&from, to)).await;
            match made.map_err(|_| StoreError::corrupt("a bag", "a thread ended early"))? {
                Ok(Some((file, new))) => {
                    let thin = file.0.metadata().map_or(0, |file| file.len());
                    self.replace_file(&old, &new, thin, &file.0).await?;
                    done.bags += 1;
                    done.before += size;
                    done.after += thin;
                }
                Ok(None) => {}
                Err(error) => done.kept.push(format!("{}: {}", old.as_str(), in_full(&error))),
            }
        }
        if done.bags > 0 {
            let mut tx = self.write().await?;
            let detail = format!("{} bags, {} bytes before, {} after", done.bags, done.before, done.after);
            audit(&mut tx, "admin", "bags made thin", "", &detail).await?;
            tx.commit().await.map_err(failed)?;
        }
        Ok(done)
    }

    /// Puts a new content in the place of another one, wherever that is.
    async fn replace_file(&self, old: &Digest, new: &Digest, bytes: u64, file: &Path) -> Result<(), StoreError> {
        let failed = |error| StoreError::database(CHANGE)(error);
        if !self.blobs.put_checked(new, file).await? {
            return Err(StoreError::corrupt("a new bag", "it changed while it was stored"));
        }
        let mut tx = self.write().await?;
        sqlx::query(
            "UPDATE files SET sha256 = $2, bytes = $3 WHERE sha256 = $1 AND stored = 1 AND \
             (SELECT s.state FROM submissions s WHERE s.id = files.submission) IN ('verified', 'refused')",
        )
        .bind(old.as_str())
        .bind(new.as_str())
        .bind(bytes as i64)
        .execute(&mut *tx)
        .await
        .map_err(failed)?;
        sqlx::query(
            "UPDATE submissions SET bytes = (SELECT SUM(f.bytes) FROM files f WHERE f.submission = submissions.id) \
             WHERE id IN (SELECT submission FROM files WHERE sha256 = $1)",
        )
        .bind(new.as_str())
        .execute(&mut *tx)
        .await
        .map_err(failed)?;
        // Before the commit, as when a submission is removed: nobody can announce it meanwhile.
        let left = sqlx::query("SELECT 1 FROM files WHERE sha256 = $1 LIMIT 1").bind(old.as_str());
        if left.fetch_optional(&mut *tx).await.map_err(failed)?.is_none() {
            self.blobs.remove(old).await?;
        }
        tx.commit().await.map_err(failed)
    }
}

/// A thin copy of a bag, with its digest; `None` if the bag is thin.
fn thin_copy(bag: &Path, to: PathBuf) -> Result<Option<(Scratch, Digest)>, StoreError> {
    let opened = Bag::open(bag).map_err(StoreError::Bag)?;
    if opened.is_thin() {
        return Ok(None);
    }
    opened.check_actions().map_err(StoreError::Bag)?;
    let copy = Scratch(to);
    std::fs::copy(bag, &copy.0).map_err(StoreError::io("write", &copy.0))?;
    convert(&copy.0, true).map_err(StoreError::Bag)?;
    let size = copy.0.metadata().map_err(StoreError::io("read", &copy.0))?.len();
    let bytes = fiatlux_files::read(&copy.0, size).map_err(StoreError::io("read", &copy.0))?;
    let digest = Digest::of(&bytes);
    Ok(Some((copy, digest)))
}
