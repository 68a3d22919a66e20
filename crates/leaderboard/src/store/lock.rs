//! The lock of a store: all scorers of a store hold it together, and whoever changes its tables holds it alone. For SQLite it is a file
//! next to the database, for PostgreSQL an advisory lock.

use std::fs::{File, TryLockError};
use std::path::Path;
use std::time::{Duration, Instant};

use sqlx::AnyConnection;
use tokio::sync::oneshot;

use crate::StoreError;

const LOCK: &str = "lock";
/// Time for which a scorer waits for another one that starts or upgrades the database.
pub(super) const PATIENCE: Duration = Duration::from_secs(10);
const LOOK: Duration = Duration::from_millis(50);

/// The lock, until it is dropped. A connection that breaks gives it up: a scorer that starts then ends claims of others, which costs a
/// verification and no verdict. Those who share it take it again as soon as the database answers.
#[derive(Debug)]
pub(super) enum Held {
    File { _file: File },
    Connection { _connection: AnyConnection },
    Shared { _until_dropped: oneshot::Sender<()> },
}

/// Locks a folder; `None` if another scorer keeps it locked for so long.
pub(super) async fn held(folder: &Path, alone: bool, patience: Duration) -> Result<Option<Held>, StoreError> {
    let path = folder.join(LOCK);
    let file = File::create(&path).map_err(StoreError::io("make", &path))?;
    let start = Instant::now();
    loop {
        match if alone { file.try_lock() } else { file.try_lock_shared() } {
            Ok(()) => return Ok(Some(Held::File { _file: file })),
            Err(TryLockError::WouldBlock) if start.elapsed() < patience => tokio::time::sleep(LOOK).await,
            Err(TryLockError::WouldBlock) => return Ok(None),
            Err(TryLockError::Error(source)) => return Err(StoreError::Io { action: "lock", path, source }),
        }
    }
}
