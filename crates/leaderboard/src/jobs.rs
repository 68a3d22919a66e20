//! The work on submissions: each is graded, then its episodes are verified, then it has its badge.
//!
//! What is to be done follows from the store ([`crate::store`]), and each step is one transaction. A service that is killed
//! anywhere in a step does it again when it is back, to the same result: grading depends on the bags alone, and a second
//! run gives the same bytes.

mod grade;
mod verify;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use fiatlux_link::{LinkArgs, in_full};
use fiatlux_policy::Access;
use tokio::task::JoinHandle;

use crate::store::now_ms;
use crate::{Service, StoreError};
use verify::Verifiers;

/// How often the grader looks by itself.
const LOOK: Duration = Duration::from_secs(2);
/// How long it waits after the store has failed.
const PAUSE: Duration = Duration::from_secs(5);
/// How often abandoned uploads are looked for.
const SWEEP: Duration = Duration::from_secs(600);
/// Age at which an upload that is not complete is removed, ms.
const STALE_MS: i64 = 7 * 24 * 3600 * 1000;

/// A sim-server that simulates episodes again.
#[derive(Debug, Clone)]
pub struct Verifier {
    /// Where it is.
    pub link: LinkArgs,
    /// Its name there; `None` where there is one server.
    pub server: Option<String>,
}

/// The work in the background of a service.
#[derive(Debug)]
pub struct Jobs {
    stop: Arc<AtomicBool>,
    tasks: Vec<JoinHandle<()>>,
    verifiers: Verifiers,
}

impl Jobs {
    /// Starts to grade, and to verify with each of the servers, `parallel` episodes at a time on each. Where there is no
    /// server, episodes wait until a service has one. Needs the runtime that the service runs on.
    ///
    /// # Errors
    /// The system gives no threads.
    pub fn start(
        service: &Arc<Service>,
        verifiers: Vec<Verifier>,
        access: Access,
        parallel: usize,
    ) -> std::io::Result<Self> {
        let stop = Arc::new(AtomicBool::new(false));
        let grader = tokio::spawn(grade_all(Arc::clone(service), Arc::clone(&stop)));
        let sweeper = tokio::spawn(sweep(Arc::clone(service)));
        let verifiers = Verifiers::start(service, verifiers, access, parallel, &stop)?;
        Ok(Self { stop, tasks: vec![grader, sweeper], verifiers })
    }

    /// Stops; what is half done is done again by the next service. Blocks until the second runs have ended.
    pub fn stop(self) {
        self.stop.store(true, Ordering::Relaxed);
        self.tasks.iter().for_each(JoinHandle::abort);
        self.verifiers.join();
    }
}

async fn grade_all(service: Arc<Service>, stop: Arc<AtomicBool>) {
    while !stop.load(Ordering::Relaxed) {
        match grade_next(&service).await {
            Ok(true) => {}
            Ok(false) => {
                // Rung, or by itself: an admin command may have changed something.
                drop(tokio::time::timeout(LOOK, service.received.notified()).await);
            }
            Err(error) => {
                tracing::error!(error = in_full(&error), "a submission could not be graded; it is tried again");
                tokio::time::sleep(PAUSE).await;
            }
        }
    }
}

async fn grade_next(service: &Arc<Service>) -> Result<bool, StoreError> {
    let Some(id) = service.store.next_received().await? else { return Ok(false) };
    grade::grade_one(service, id).await?;
    service.metrics.graded.fetch_add(1, Ordering::Relaxed);
    Ok(true)
}

async fn sweep(service: Arc<Service>) {
    loop {
        match sweep_once(&service).await {
            Ok(0) => {}
            Ok(removed) => tracing::info!(removed, "uploads that were never finished are removed"),
            Err(error) => tracing::error!(error = in_full(&error), "old uploads could not be removed"),
        }
        tokio::time::sleep(SWEEP).await;
    }
}

async fn sweep_once(service: &Service) -> Result<usize, StoreError> {
    let stale = service.store.stale(now_ms() - STALE_MS).await?;
    for id in &stale {
        service.store.remove(*id, "service").await?;
    }
    Ok(stale.len())
}
