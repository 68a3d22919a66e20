//! The running service: the state that its handlers and its jobs share.

use std::path::PathBuf;
use std::time::Duration;

use fiatlux_access::KnownServers;
use tokio::sync::{Notify, Semaphore};

use crate::Store;
use crate::counts::Metrics;
use crate::forwarded::Proxies;
use crate::store::LEASE;
use crate::submission::Limits;

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
    /// Time after which the work of a scorer that was killed goes to another one, at most 20 s. It is renewed four times as often.
    pub lease: Duration,
}

impl Default for ServiceOptions {
    /// The defaults of [`Limits`] and [`Pace`], 4 s, nobody's keys, no proxies, all cores, no folders, 3 minutes, 20 s.
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
            lease: LEASE,
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
        }
    }
}
