//! The lock of a folder: all scorers of a folder hold it together, and whoever changes its tables holds it alone.

use std::fs::{File, TryLockError};
use std::path::Path;
use std::time::{Duration, Instant};

use crate::StoreError;

const LOCK: &str = "lock";
/// Time for which a scorer waits for another one that starts or upgrades the database.
pub(super) const PATIENCE: Duration = Duration::from_secs(10);
const LOOK: Duration = Duration::from_millis(50);

/// Locks a folder against all scorers.
pub(super) async fn alone(folder: &Path) -> Result<File, StoreError> {
    let locked = lock(folder, File::try_lock, PATIENCE).await?;
    locked.ok_or_else(|| StoreError::InUse { folder: folder.into() })
}

/// Locks a folder in this way; `None` if another scorer keeps it locked for so long.
pub(super) async fn lock(
    folder: &Path,
    way: fn(&File) -> Result<(), TryLockError>,
    patience: Duration,
) -> Result<Option<File>, StoreError> {
    let path = folder.join(LOCK);
    let file = File::create(&path).map_err(StoreError::io("make", &path))?;
    let start = Instant::now();
    loop {
        match way(&file) {
            Ok(()) => return Ok(Some(file)),
            Err(TryLockError::WouldBlock) if start.elapsed() < patience => tokio::time::sleep(LOOK).await,
            Err(TryLockError::WouldBlock) => return Ok(None),
            Err(TryLockError::Error(source)) => return Err(StoreError::Io { action: "lock", path, source }),
        }
    }
}
