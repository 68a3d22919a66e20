//! Work that takes a core for a while, such as reading a bag's rows. Few jobs run at once, and few requests wait for one.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use tokio::sync::Semaphore;

use super::answer::Problem;

/// Number of jobs that may run at once.
const AT_ONCE: usize = 2;
/// Number of requests that may run or wait; further ones are refused.
const WAITING: usize = 96;

/// Runs heavy work on threads of its own, and limits how much.
#[derive(Debug)]
pub(super) struct Heavy {
    permits: Arc<Semaphore>,
    asked: Arc<AtomicUsize>,
}

/// Counts a request until it is dropped.
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
    /// Runs `work` on another thread, once it is its turn.
    ///
    /// # Errors
    /// [`Problem::Busy`] if too many requests wait already.
    pub async fn run<T: Send + 'static>(&self, work: impl FnOnce() -> T + Send + 'static) -> Result<T, Problem> {
        let before = self.asked.fetch_add(1, Ordering::Relaxed);
        let asked = Asked(Arc::clone(&self.asked));
        if before >= WAITING {
            return Err(Problem::Busy);
        }
        let permit = Arc::clone(&self.permits).acquire_owned().await.map_err(|_| Problem::Failed)?;
        // If the client goes away, the work still runs to its end, and counts until then.
        let done = tokio::task::spawn_blocking(move || {
            let made = work();
            drop((permit, asked));
            made
        });
        done.await.map_err(|_| Problem::Failed)
    }
}
