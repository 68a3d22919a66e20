//! Work that takes a core for a while: reading a bag's rows. Little of it runs at once, and few requests wait for it.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use tokio::sync::Semaphore;

use super::answer::Problem;

/// Jobs at once.
const AT_ONCE: usize = 2;
/// Requests that may wait.
const WAITING: usize = 96;

/// Runs heavy work.
#[derive(Debug)]
pub(super) struct Heavy {
    permits: Arc<Semaphore>,
    asked: Arc<AtomicUsize>,
}

/// Counts a request for as long as it is there.
struct Asked(Arc<AtomicUsize>);

impl Drop for Asked {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::Relaxed);
    }
}

impl Default for Heavy {
    fn default() -> Self {
        Self { permits: Arc::new(Semaphore::new(AT_ONCE)), asked: Arc::default() }
    }
}

impl Heavy {
    /// Runs some of it on a thread of its own.
    ///
    /// # Errors
    /// [`Problem::Busy`] where too many wait already.
    pub async fn run<T: Send + 'static>(&self, work: impl FnOnce() -> T + Send + 'static) -> Result<T, Problem> {
        let before = self.asked.fetch_add(1, Ordering::Relaxed);
        let asked = Asked(Arc::clone(&self.asked));
        if before >= WAITING {
            return Err(Problem::Busy);
        }
        let permit = Arc::clone(&self.permits).acquire_owned().await.map_err(|_| Problem::Failed)?;
        // Where the client goes away, the work is done all the same, and counts until then.
        let done = tokio::task::spawn_blocking(move || {
            let made = work();
            drop((permit, asked));
            made
        });
        done.await.map_err(|_| Problem::Failed)
    }
}
