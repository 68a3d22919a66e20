//! The work on submissions: each is graded, then its episodes are verified, then it gets its pictures. What it proves by
//! then, [`crate::claims`] decides.
//!
//! The state of the store ([`crate::store`]) determines what there is to do, and each step is one transaction. A service
//! that is killed in the middle of a step repeats it after the next start, with the same result: grading depends on the
//! bags alone, and simulating an episode again gives the same bytes.
//!
//! Several services may work on one store. All of them verify; one at a time grades, and one draws ([`Duty`]), since whose rows an
//! episode has depends on the order in which submissions are graded.

mod draw;
mod grade;
mod runs;
mod server;
mod verify;

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use fiatlux_cli::in_full;
use tokio::task::JoinHandle;

use crate::store::{Duty, Term, now_ms};
use crate::{Service, StoreError, SubmissionId};
pub use server::{ServerGroup, ServerVerifier};
use verify::Workers;
pub use verify::{Verifier, VerifierGroup, Verifiers, VerifyOutcome};

/// Time between two looks for work of the grader without a notification.
const LOOK: Duration = Duration::from_secs(2);
/// Pause of the grader after an error of the store.
const PAUSE: Duration = Duration::from_secs(5);
/// Time between two removals of abandoned uploads.
const SWEEP: Duration = Duration::from_secs(600);
/// Age at which an incomplete upload is removed, ms.
const STALE_MS: i64 = 7 * 24 * 3600 * 1000;

#[derive(Debug)]
pub struct Jobs {
    stop: Arc<AtomicBool>,
    tasks: Vec<JoinHandle<()>>,
    workers: Workers,
}

impl Jobs {
    /// Starts to grade, and to verify `parallel` episodes at a time by each of the verifiers. Without one, episodes wait for a service
    /// that has some. Must be called on the Tokio runtime of the service.
    pub fn start(service: &Arc<Service>, verifiers: impl Into<Verifiers>, parallel: usize) -> std::io::Result<Self> {
        let stop = Arc::new(AtomicBool::new(false));
        let grader = tokio::spawn(grade_all(Arc::clone(service), Arc::clone(&stop)));
        let drawer = tokio::spawn(draw_all(Arc::clone(service), Arc::clone(&stop)));
        let sweeper = tokio::spawn(sweep(Arc::clone(service)));
        let runs = tokio::spawn(runs::follow(Arc::clone(service)));
        let workers = Workers::start(service, verifiers.into(), parallel, &stop)?;
        Ok(Self { stop, tasks: vec![grader, drawer, sweeper, runs], workers })
    }

    /// Starts to verify, as [`Jobs::start`] does, and nothing else.
    pub fn verify(service: &Arc<Service>, verifiers: impl Into<Verifiers>, parallel: usize) -> std::io::Result<Self> {
        let stop = Arc::new(AtomicBool::new(false));
        let workers = Workers::start(service, verifiers.into(), parallel, &stop)?;
        Ok(Self { stop, tasks: Vec::new(), workers })
    }

    /// Stops, and blocks until the running simulations have ended. The next service repeats unfinished work.
    pub fn stop(self) {
        self.stop.store(true, Ordering::Relaxed);
        self.tasks.iter().for_each(JoinHandle::abort);
        self.workers.join();
    }
}

async fn grade_all(service: Arc<Service>, stop: Arc<AtomicBool>) {
    while !stop.load(Ordering::Relaxed) {
        match grade_next(&service).await {
            Ok(true) => {}
            Ok(false) => {
                // Also looks without a notification: an admin command may have changed something.
                drop(tokio::time::timeout(LOOK, service.received.notified()).await);
            }
            Err(error) => {
                tracing::error!(error = in_full(&error), "a submission could not be graded; trying again");
                tokio::time::sleep(PAUSE).await;
            }
        }
    }
}

/// Grades the next submission, unless another scorer grades; returns `false` if there is nothing to do.
async fn grade_next(service: &Arc<Service>) -> Result<bool, StoreError> {
    let store = &service.store;
    if store.next_unindexed().await?.is_none() && store.next_received().await?.is_none() {
        return Ok(false);
    }
    on_duty(service, Duty::Grade, async |term| grade_on(service, term).await).await
}

async fn grade_on(service: &Arc<Service>, term: Term) -> Result<bool, StoreError> {
    // Whose rows are whose is known before a new submission is compared with them.
    if let Some(id) = service.store.next_unindexed().await? {
        grade::index_one(service, term, id).await?;
        return Ok(true);
    }
    let Some(id) = service.store.next_received().await? else { return Ok(false) };
    grade::grade_one(service, term, id).await?;
    service.metrics.graded.fetch_add(1, Ordering::Relaxed);
    Ok(true)
}

/// Does work of a duty while its lease is renewed; returns `false` without it while another scorer has the duty.
async fn on_duty(
    service: &Arc<Service>,
    duty: Duty,
    work: impl AsyncFnOnce(Term) -> Result<bool, StoreError>,
) -> Result<bool, StoreError> {
    let lease = service.options.lease;
    let Some(term) = service.store.take(duty, lease).await? else { return Ok(false) };
    let keeping = Arc::clone(service);
    let renewal = tokio::spawn(async move {
        loop {
            tokio::time::sleep(lease / 4).await;
            match keeping.store.keep(term, lease).await {
                Ok(true) => {}
                Ok(false) => return,
                Err(error) => tracing::warn!(error = in_full(&error), "cannot renew a duty"),
            }
        }
    });
    let _renewal = AbortOnDrop(renewal);
    let done = work(term).await;
    service.store.keep(term, Duration::ZERO).await?;
    done
}

/// A task that ends with its owner, also where that is aborted.
struct AbortOnDrop(JoinHandle<()>);

impl Drop for AbortOnDrop {
    fn drop(&mut self) {
        self.0.abort();
    }
}

/// Draws on one thread, after everything else: pages are complete without pictures.
async fn draw_all(service: Arc<Service>, stop: Arc<AtomicBool>) {
    while !stop.load(Ordering::Relaxed) {
        match draw_next(&service, &stop).await {
            Ok(true) => {}
            Ok(false) => tokio::time::sleep(LOOK).await,
            Err(error) => {
                tracing::error!(error = in_full(&error), "pictures could not be stored; trying again");
                tokio::time::sleep(PAUSE).await;
            }
        }
    }
}

async fn draw_next(service: &Arc<Service>, stop: &Arc<AtomicBool>) -> Result<bool, StoreError> {
    if service.store.next_undrawn().await?.is_none() {
        return Ok(false);
    }
    on_duty(service, Duty::Draw, async |_| draw::draw_next(service, stop).await).await
}

async fn sweep(service: Arc<Service>) {
    let mut stale = Stale::default();
    loop {
        match sweep_once(&service, &mut stale).await {
            Ok(0) => {}
            Ok(removed) => tracing::info!(removed, "removed uploads that were never finished"),
            Err(error) => tracing::error!(error = in_full(&error), "cannot remove uploads that were never finished"),
        }
        tokio::time::sleep(SWEEP).await;
    }
}

async fn sweep_once(service: &Service, stale: &mut Stale) -> Result<usize, StoreError> {
    let found = service.store.stale(now_ms() - STALE_MS).await?;
    let due = stale.due(&found, Instant::now());
    for id in &due {
        service.store.remove(*id, "service").await?;
    }
    Ok(due.len())
}

/// Incomplete uploads that are old by the clock, and since when they have been. Where the clock is set forward, as at the start of a
/// machine without one of its own, an upload that was begun a minute ago is old by it at once.
#[derive(Debug, Default)]
struct Stale(BTreeMap<SubmissionId, Instant>);

impl Stale {
    /// Time that an upload keeps after it was first seen to be old.
    const KEPT: Duration = Duration::from_secs(6 * 3600);

    /// Those of `found` that have been old for long enough to be removed.
    fn due(&mut self, found: &[SubmissionId], now: Instant) -> Vec<SubmissionId> {
        self.0.retain(|id, _| found.contains(id));
        let is_due = |id: &&SubmissionId| now.duration_since(*self.0.entry(**id).or_insert(now)) >= Self::KEPT;
        found.iter().filter(is_due).copied().collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Guards an upload under way against a clock that is set forward by years, and then back.
    #[test]
    fn an_upload_that_a_clock_makes_old_has_time_to_arrive() {
        let (young, old) = (SubmissionId(1), SubmissionId(2));
        let (mut stale, start) = (Stale::default(), Instant::now());
        let later = |hours: u64| start + Duration::from_secs(hours * 3600);
        assert_eq!(stale.due(&[young, old], later(0)), []);
        assert_eq!(stale.due(&[young, old], later(5)), []);
        // The clock is set back for one of them.
        assert_eq!(stale.due(&[old], later(6)), [old]);
        assert_eq!(stale.due(&[young], later(7)), [], "it is old anew");
        assert_eq!(stale.due(&[young], later(13)), [young]);
    }
}
