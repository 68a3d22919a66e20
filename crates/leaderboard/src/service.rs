//! The running service: the state that its handlers and its jobs share.

use std::collections::BTreeSet;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use fiatlux_access::KnownServers;
use tokio::sync::{Notify, Semaphore};

use crate::counts::Metrics;
use crate::forwarded::Proxies;
use crate::submission::Limits;
use crate::{Store, SubmissionId};

/// Maximum number of uploads whose content is compared with its digest at once: half of the cores are left to pages.
const MAX_SEALERS: usize = 4;
/// Maximum number of uploads whose bytes are written at once.
const WRITERS: usize = 2;

/// The minimum speed of a client, for uploads and for answers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Pace {
    /// Maximum time without a byte; after it the connection is cut.
    pub silence: Duration,
    /// Grace period before the lowest rate is enforced.
    pub start: Duration,
    /// Minimum average rate, bytes/s.
    pub min_rate: u64,
}

impl Default for Pace {
    /// 30 s, 20 s, 4,096 bytes/s.
    fn default() -> Self {
        Self { silence: Duration::from_secs(30), start: Duration::from_secs(20), min_rate: 4096 }
    }
}

#[derive(Debug, Clone)]
pub struct ServiceOptions {
    pub limits: Limits,
    /// Slower clients are cut; their uploads can be resumed.
    pub pace: Pace,
    /// Maximum pause before the answer to a wrong token, for an address that has sent several.
    pub token_pause: Duration,
    /// Keys of the operator's own servers, whose signatures make a run *hosted*.
    pub signers: KnownServers,
    /// Proxies that say who asks them, besides those of this machine.
    pub proxies: Proxies,
    /// Threads that grade; 0 means one per core.
    pub grade_workers: usize,
    /// Folders into which the operator's own servers record runs: every hosted run that was registered counts.
    pub runs: Vec<PathBuf>,
    /// Time between two refusals of an episode by servers that count.
    pub refusal_pause: Duration,
}

impl Default for ServiceOptions {
    /// The defaults of [`Limits`] and [`Pace`], 4 s, nobody's keys, no proxies, all cores, no folders, 3 minutes.
    fn default() -> Self {
        Self {
            limits: Limits::default(),
            pace: Pace::default(),
            token_pause: Duration::from_secs(4),
            signers: KnownServers::default(),
            proxies: Proxies::default(),
            grade_workers: 0,
            runs: Vec::new(),
            refusal_pause: Duration::from_secs(180),
        }
    }
}

#[derive(Debug)]
pub struct Service {
    pub store: Store,
    pub(crate) options: ServiceOptions,
    pub(crate) metrics: Metrics,
    pub(crate) received: Notify,
    pub(crate) sealers: Semaphore,
    pub(crate) writers: Semaphore,
    busy: Mutex<BTreeSet<(SubmissionId, u32)>>,
}

impl Service {
    /// A service on an open store; it does nothing until its router is served and its jobs are started.
    pub fn new(store: Store, options: ServiceOptions) -> Self {
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        Self {
            store,
            options,
            metrics: Metrics::default(),
            received: Notify::new(),
            sealers: Semaphore::new((cores / 2).clamp(1, MAX_SEALERS)),
            writers: Semaphore::new(WRITERS),
            busy: Mutex::default(),
        }
    }

    /// The exclusive right to write one file of a submission; `None` while another request has it.
    pub(crate) fn claim(self: &Arc<Self>, id: SubmissionId, place: u32) -> Option<Claim> {
        let mut busy = self.busy.lock().unwrap_or_else(PoisonError::into_inner);
        busy.insert((id, place)).then(|| Claim { service: Arc::clone(self), what: (id, place) })
    }
}

/// The right of one request to write a file; dropping it frees the file.
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
