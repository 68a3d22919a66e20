//! Work that takes a core for a while, such as reading a bag's rows. Few jobs run at once, and few requests wait for one.

use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use fiatlux_bag::Patience;
use fiatlux_grading::patience;
use tokio::sync::Semaphore;

use super::answer::Problem;

/// Number of jobs that may run at once.
const AT_ONCE: usize = 2;
/// Maximum number of requests that run or wait; further ones are refused.
const WAITING: usize = 96;
/// Time limit for reading a bag, without simulating a thin one. An episode of 120 s takes less than a second.
const READ_TIME: Duration = Duration::from_secs(10);
/// Maximum number of slow bags that are remembered.
const MAX_SLOW: usize = 4096;

/// Runs heavy work on separate threads, and limits it.
#[derive(Debug)]
pub(super) struct Heavy {
    permits: Arc<Semaphore>,
    asked: Arc<AtomicUsize>,
    /// Bags that took too long, which are not read again.
    slow: Mutex<VecDeque<PathBuf>>,
    read_time: Duration,
}

/// Counts a request until it is dropped.
struct PendingRequest(Arc<AtomicUsize>);

impl Drop for PendingRequest {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::Relaxed);
    }
}

impl Default for Heavy {
    fn default() -> Self {
        Self {
            permits: Arc::new(Semaphore::new(AT_ONCE)),
            asked: Arc::default(),
            slow: Mutex::default(),
            read_time: READ_TIME,
        }
    }
}

impl Heavy {
    /// Runs `work` on another thread when its turn comes.
    ///
    /// # Errors
    /// [`Problem::Busy`] if too many requests wait already.
    pub async fn run<T: Send + 'static>(&self, work: impl FnOnce() -> T + Send + 'static) -> Result<T, Problem> {
        let before = self.asked.fetch_add(1, Ordering::Relaxed);
        let asked = PendingRequest(Arc::clone(&self.asked));
        if before >= WAITING {
            return Err(Problem::Busy);
        }
        let permit = Arc::clone(&self.permits).acquire_owned().await.map_err(|_| Problem::Failed)?;
        // If the client disconnects, the work still runs to its end, and counts until then.
        let done = tokio::task::spawn_blocking(move || {
            let made = work();
            drop((permit, asked));
            made
        });
        done.await.map_err(|_| Problem::Failed)
    }

    /// As [`Heavy::run`], for work that reads a bag with a patience of [`READ_TIME`]. A slower bag is not read again.
    ///
    /// # Errors
    /// Also [`Problem::Unshowable`] if it took too long, now or before.
    pub async fn read<T: Send + 'static>(
        &self,
        bag: &Path,
        work: impl FnOnce(Patience) -> T + Send + 'static,
    ) -> Result<T, Problem> {
        let read_time = self.read_time;
        let too_slow = || Problem::Unshowable("It takes too long to read.".into());
        if self.slow().iter().any(|slow| slow == bag) {
            return Err(too_slow());
        }
        let path = bag.to_owned();
        let timed = move || {
            let patience = patience(read_time, &path);
            (work(patience.clone()), patience.goes_on())
        };
        let (made, in_time) = self.run(timed).await?;
        if in_time {
            return Ok(made);
        }
        let mut slow = self.slow();
        if slow.len() >= MAX_SLOW {
            slow.pop_front();
        }
        slow.push_back(bag.into());
        Err(too_slow())
    }

    fn slow(&self) -> MutexGuard<'_, VecDeque<PathBuf>> {
        self.slow.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    /// Guards against a bag that keeps a core busy with each request.
    #[tokio::test]
    async fn a_bag_that_takes_too_long_is_read_once() {
        let heavy = Heavy { read_time: Duration::from_millis(50), ..Heavy::default() };
        let slow = |patience: Patience| {
            let start = std::time::Instant::now();
            while patience.goes_on() {
                assert!(start.elapsed() < Duration::from_secs(10), "it does not end");
                std::thread::sleep(Duration::from_millis(5));
            }
        };
        let (hostile, good) = (Path::new("hostile"), Path::new("good"));
        assert!(matches!(heavy.read(hostile, slow).await, Err(Problem::Unshowable(_))));
        let again = heavy.read(hostile, |_| panic!("it is read again")).await;
        assert!(matches!(again, Err::<(), _>(Problem::Unshowable(_))));
        assert!(heavy.read(good, |patience| patience.goes_on()).await.unwrap());
    }
}
