//! The running service: what its handlers and its jobs share.

use std::collections::BTreeSet;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use axum::Router;
use axum::middleware::from_fn_with_state;
use fiatlux_access::KnownServers;
use tokio::sync::{Notify, Semaphore};

use crate::metrics::Metrics;
use crate::submission::Limits;
use crate::{Store, SubmissionId, api, metrics, pages};

/// Most uploads whose content is compared with its digest at once: half of the cores are left to those who read pages.
const MOST_SEALERS: usize = 4;
/// Uploads whose bytes are written at once.
const WRITERS: usize = 2;

/// How slowly an upload may come.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Pace {
    /// Longest silence.
    pub silence: Duration,
    /// Time before it must have its least rate.
    pub start: Duration,
    /// Least rate over all its time, bytes/s.
    pub least_rate: u64,
}

impl Default for Pace {
    /// 30 s, 20 s, 4,096 bytes/s.
    fn default() -> Self {
        Self { silence: Duration::from_secs(30), start: Duration::from_secs(20), least_rate: 4096 }
    }
}

/// How a service treats what it is sent.
#[derive(Debug, Clone, Default)]
pub struct ServiceOptions {
    /// How much a submission may be.
    pub limits: Limits,
    /// How slowly it may come.
    pub pace: Pace,
    /// Whose signatures make a run *hosted*: the keys of our own servers.
    pub signers: KnownServers,
    /// Threads that grade; 0 for one for each core.
    pub grade_workers: usize,
}

/// What handlers and jobs share.
#[derive(Debug)]
pub struct Service {
    /// Submissions, results and bags.
    pub store: Store,
    pub(crate) options: ServiceOptions,
    pub(crate) metrics: Metrics,
    /// Rung when a submission is received.
    pub(crate) received: Notify,
    pub(crate) sealers: Semaphore,
    pub(crate) writers: Semaphore,
    busy: Mutex<BTreeSet<(SubmissionId, u32)>>,
}

impl Service {
    /// Over an open store.
    pub fn new(store: Store, options: ServiceOptions) -> Self {
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        Self {
            store,
            options,
            metrics: Metrics::default(),
            received: Notify::new(),
            sealers: Semaphore::new((cores / 2).clamp(1, MOST_SEALERS)),
            writers: Semaphore::new(WRITERS),
            busy: Mutex::default(),
        }
    }

    /// The right to write one file of a submission; `None` while another request has it.
    pub(crate) fn claim(self: &Arc<Self>, id: SubmissionId, place: u32) -> Option<Claim> {
        let mut busy = self.busy.lock().unwrap_or_else(PoisonError::into_inner);
        busy.insert((id, place)).then(|| Claim { service: Arc::clone(self), what: (id, place) })
    }
}

/// A file that one request writes.
#[derive(Debug)]
pub(crate) struct Claim {
    service: Arc<Service>,
    what: (SubmissionId, u32),
}

impl Drop for Claim {
    fn drop(&mut self) {
        self.service.busy.lock().unwrap_or_else(PoisonError::into_inner).remove(&self.what);
    }
}

/// All that is answered: `/api/...`, `/health`, `/ready`, `/metrics` and the pages.
pub fn router(service: Arc<Service>) -> Router {
    let measured = from_fn_with_state(Arc::clone(&service), metrics::measure);
    api::router(Arc::clone(&service)).merge(pages::router(service)).layer(measured)
}
