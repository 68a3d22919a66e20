//! Workers that claim episodes and have them verified.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use fiatlux_cli::in_full;
use tokio::runtime::Handle;

use crate::store::{EpisodeJob, Return, Verdict};
use crate::{Service, StoreError};

/// Time between two looks for work of an idle worker.
const LOOK: Duration = Duration::from_millis(250);
/// Time between two looks for the servers of a group, and how often in a row one is not there until it is gone: a token may come late.
const MEMBERS: Duration = Duration::from_millis(if cfg!(test) { 300 } else { 3_000 });
const MISSED: u32 = 2;
/// Minimum and maximum pause of a worker whose server does not answer.
const PAUSES: (Duration, Duration) = (Duration::from_secs(1), Duration::from_secs(60));
/// Pause of an episode after a verification that failed without a verdict.
const LATER: Duration = Duration::from_secs(10);
/// Time after which a server is asked for its version again, while episodes wait for a certain one.
const SAME_VERSION: Duration = Duration::from_secs(30);
/// After this many refusals by servers of the bag's own version, a pause between them, an episode cannot be replayed. Before
/// that an operator may be in the middle of an upgrade.
const MAX_REFUSALS: i64 = 3;

/// Simulates episodes again, one for each thread that calls it.
pub trait Verifier: std::fmt::Debug + Send + Sync {
    /// For the log, and for the audit of verdicts.
    fn name(&self) -> &str;

    /// The version of its simulator now; `None` if that is not known.
    fn version(&self) -> Option<String>;

    /// Simulates a bag, a file with this SHA-256, and counts the steps. Ends early once `stop` is set.
    fn verify(&self, bag: &Path, sha256: &str, steps: &mut u64, stop: &AtomicBool) -> VerifyOutcome;
}

/// Servers that come and go.
pub trait VerifierGroup: std::fmt::Debug + Send + Sync {
    /// One for each server that is there now; `None` if nobody can tell, as without a link.
    fn present(&self) -> Option<Vec<Arc<dyn Verifier>>>;
}

/// All that verify: named servers, and groups.
#[derive(Debug, Default)]
pub struct Verifiers {
    pub servers: Vec<Arc<dyn Verifier>>,
    pub groups: Vec<Arc<dyn VerifierGroup>>,
}

impl Verifiers {
    pub fn is_empty(&self) -> bool {
        self.servers.is_empty() && self.groups.is_empty()
    }
}

impl From<Vec<Arc<dyn Verifier>>> for Verifiers {
    fn from(servers: Vec<Arc<dyn Verifier>>) -> Self {
        Self { servers, groups: Vec::new() }
    }
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub enum VerifyOutcome {
    Decided(Verdict, String),
    /// The server or its connection failed, so there is no verdict: try again.
    Again(String),
    /// The server is of another version than the bag, and its word means nothing.
    OtherVersion {
        bag: String,
        reason: String,
    },
    /// A server of the bag's version refuses to play it.
    NotTaken(String),
    Stopped,
}

/// The worker threads, `parallel` for each verifier, and those that follow groups.
#[derive(Debug)]
pub(super) struct Workers(Vec<JoinHandle<()>>);

struct Worker {
    service: Arc<Service>,
    runtime: Handle,
    verifier: Arc<dyn Verifier>,
    stop: Arc<AtomicBool>,
    /// Its server is gone.
    is_gone: Arc<AtomicBool>,
    /// The version of the server, and when it was asked for it.
    version: Option<(Instant, String)>,
}

/// Starts the workers of verifiers, those of a group as well.
#[derive(Clone)]
struct Starter {
    service: Arc<Service>,
    runtime: Handle,
    parallel: usize,
    stop: Arc<AtomicBool>,
}

impl Starter {
    /// The workers of a verifier, until it is gone.
    fn start(
        &self,
        verifier: &Arc<dyn Verifier>,
        is_gone: &Arc<AtomicBool>,
        threads: &mut Vec<JoinHandle<()>>,
    ) -> std::io::Result<()> {
        for _ in 0..self.parallel {
            let worker = Worker {
                service: Arc::clone(&self.service),
                runtime: self.runtime.clone(),
                verifier: Arc::clone(verifier),
                stop: Arc::clone(&self.stop),
                is_gone: Arc::clone(is_gone),
                version: None,
            };
            threads.push(std::thread::Builder::new().name("verify".into()).spawn(move || worker.run())?);
        }
        Ok(())
    }

    /// Has workers for each server of a group while it is there.
    fn follow(self, group: &dyn VerifierGroup) {
        let mut members: BTreeMap<String, (Arc<AtomicBool>, u32)> = BTreeMap::new();
        let mut threads = Vec::new();
        while !self.stop.load(Ordering::Relaxed) {
            if let Some(present) = group.present() {
                members.retain(|name, (is_gone, missed)| {
                    let is_there = present.iter().any(|verifier| verifier.name() == name);
                    *missed = if is_there { 0 } else { *missed + 1 };
                    if *missed >= MISSED {
                        tracing::info!(server = name, "it is gone; others verify");
                        is_gone.store(true, Ordering::Relaxed);
                    }
                    *missed < MISSED
                });
                for verifier in present {
                    if members.contains_key(verifier.name()) {
                        continue;
                    }
                    tracing::info!(server = verifier.name(), "it verifies from now on");
                    let (is_gone, _) = members.entry(verifier.name().to_owned()).or_default();
                    if let Err(error) = self.start(&verifier, is_gone, &mut threads) {
                        tracing::error!(error = in_full(&error), "cannot start a thread");
                    }
                }
            }
            threads.retain(|thread| !thread.is_finished());
            sleep(&self.stop, MEMBERS);
        }
        Workers(threads).join();
    }
}

/// Sleeps, or until something is set.
fn sleep(stop: &AtomicBool, time: Duration) {
    let start = Instant::now();
    while !stop.load(Ordering::Relaxed) && start.elapsed() < time {
        std::thread::sleep(time.min(Duration::from_millis(50)));
    }
}

impl Workers {
    pub fn start(
        service: &Arc<Service>,
        verifiers: Verifiers,
        parallel: usize,
        stop: &Arc<AtomicBool>,
    ) -> std::io::Result<Self> {
        let starter =
            Starter { service: Arc::clone(service), runtime: Handle::current(), parallel, stop: Arc::clone(stop) };
        let mut threads = Vec::new();
        for verifier in verifiers.servers {
            starter.start(&verifier, &Arc::default(), &mut threads)?;
        }
        for group in verifiers.groups {
            let starter = starter.clone();
            let follow = move || starter.follow(group.as_ref());
            threads.push(std::thread::Builder::new().name("servers".into()).spawn(follow)?);
        }
        Ok(Self(threads))
    }

    pub fn join(self) {
        for thread in self.0 {
            if thread.join().is_err() {
                tracing::error!("a thread that verifies has panicked");
            }
        }
    }
}

impl Worker {
    fn run(mut self) {
        let mut pause = PAUSES.0;
        while !self.stop.load(Ordering::Relaxed) && !self.is_gone.load(Ordering::Relaxed) {
            let job = match self.claim() {
                Ok(Some(job)) => job,
                Ok(None) => {
                    sleep(&self.stop, LOOK);
                    continue;
                }
                Err(error) => {
                    tracing::error!(error = in_full(&error), "cannot read the next job from the store");
                    sleep(&self.stop, PAUSES.1);
                    continue;
                }
            };
            let renewal = self.runtime.spawn(renew(Arc::clone(&self.service), job.clone()));
            let outcome = self.again(&job);
            renewal.abort();
            let is_idle = matches!(outcome, VerifyOutcome::Again(_));
            if matches!(outcome, VerifyOutcome::OtherVersion { .. }) {
                self.version = None;
            }
            if let Err(error) = self.take_in(&job, outcome) {
                tracing::error!(error = in_full(&error), "cannot store the outcome of a verification; it is repeated");
                sleep(&self.stop, PAUSES.0);
            }
            if is_idle {
                sleep(&self.stop, pause);
                pause = (pause * 2).min(PAUSES.1);
            } else {
                pause = PAUSES.0;
            }
        }
    }

    /// Claims the next episode that this server may decide.
    fn claim(&mut self) -> Result<Option<EpisodeJob>, StoreError> {
        let store = &self.service.store;
        let is_old = self.version.as_ref().is_none_or(|(asked, _)| asked.elapsed() >= SAME_VERSION);
        if is_old && self.runtime.block_on(store.wants_version())? {
            self.version = Some((Instant::now(), self.verifier.version().unwrap_or_default()));
        }
        let version = self.version.as_ref().map_or("", |(_, version)| version);
        self.runtime.block_on(store.claim(version, self.service.options.lease))
    }

    fn again(&self, job: &EpisodeJob) -> VerifyOutcome {
        let path = match self.runtime.block_on(self.service.store.blobs.local(&job.bag)) {
            Ok(path) => path,
            Err(error) => return VerifyOutcome::Again(in_full(&error)),
        };
        let (start, mut steps) = (Instant::now(), 0);
        let outcome = self.verifier.verify(&path, job.bag.as_str(), &mut steps, &self.stop);
        let metrics = &self.service.metrics;
        metrics.verifying_ms.fetch_add(start.elapsed().as_millis() as u64, Ordering::Relaxed);
        metrics.verified_steps.fetch_add(steps, Ordering::Relaxed);
        outcome
    }

    fn take_in(&self, job: &EpisodeJob, outcome: VerifyOutcome) -> Result<(), StoreError> {
        let metrics = &self.service.metrics;
        let decide = |verdict, detail: &str| {
            if self.runtime.block_on(self.service.store.set_verdict(job, verdict, self.verifier.name(), detail))? {
                metrics.verified.fetch_add(1, Ordering::Relaxed);
            } else {
                tracing::info!(episode = %job, server = self.verifier.name(), "it is decided or claimed again; this verdict is not used");
            }
            Ok(())
        };
        let release = |pause, why: &Return| self.runtime.block_on(self.service.store.release(job, pause, why));
        match outcome {
            VerifyOutcome::Stopped => release(Duration::ZERO, &Return::Unplayed),
            VerifyOutcome::Decided(verdict, detail) => {
                if verdict != Verdict::Equal {
                    tracing::info!(submission = %job.submission, episode = %job, server = self.verifier.name(), detail, "differs");
                }
                decide(verdict, &detail)
            }
            VerifyOutcome::Again(reason) => {
                metrics.retries.fetch_add(1, Ordering::Relaxed);
                tracing::warn!(episode = %job, server = self.verifier.name(), reason, "could not be verified; trying again later");
                // An episode that always fails must not hold up the others.
                release(LATER, &Return::Unplayed)
            }
            VerifyOutcome::OtherVersion { bag, reason } => {
                metrics.retries.fetch_add(1, Ordering::Relaxed);
                tracing::warn!(episode = %job, server = self.verifier.name(), reason, "it waits for a server of its version");
                release(Duration::ZERO, &Return::OtherVersion(bag))
            }
            VerifyOutcome::NotTaken(reason) => {
                metrics.retries.fetch_add(1, Ordering::Relaxed);
                tracing::warn!(episode = %job, server = self.verifier.name(), reason, "the server refuses to play it");
                if job.refusals + 1 < MAX_REFUSALS {
                    return release(self.service.options.refusal_pause, &Return::Refused);
                }
                decide(Verdict::Refused, &format!("no server plays it again: {reason}"))
            }
        }
    }
}

/// Renews a claim until it is aborted, or the claim has ended.
async fn renew(service: Arc<Service>, job: EpisodeJob) {
    let lease = service.options.lease;
    loop {
        tokio::time::sleep(lease / 4).await;
        match service.store.renew(&job, lease).await {
            Ok(true) => {}
            Ok(false) => return,
            Err(error) => tracing::warn!(error = in_full(&error), "cannot renew the claim on an episode"),
        }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    mod killed;

    use std::collections::BTreeMap;
    use std::sync::Mutex;

    use super::*;
    use crate::jobs::Jobs;
    use crate::store::queue::tests::{Folder, fill};
    use crate::{ServiceOptions, Store};

    /// Sleeps instead of a simulation, and counts each bag's verifications.
    #[derive(Debug)]
    struct Sleeper {
        time: Duration,
        played: Mutex<BTreeMap<String, u64>>,
    }

    impl Verifier for Sleeper {
        fn name(&self) -> &str {
            "sleeper"
        }

        fn version(&self) -> Option<String> {
            None
        }

        fn verify(&self, bag: &Path, _: &str, _: &mut u64, _: &AtomicBool) -> VerifyOutcome {
            *self.played.lock().unwrap().entry(bag.display().to_string()).or_default() += 1;
            std::thread::sleep(self.time);
            VerifyOutcome::Decided(Verdict::Equal, String::new())
        }
    }

    /// Runs services on one store, each with connections of its own, until nothing waits; returns how often something was verified.
    fn work(name: &str, (services, submissions, each): (u64, u64, u64), lease: Duration, time: Duration) -> u64 {
        let folder = Folder::new(name);
        let runtime = tokio::runtime::Runtime::new().unwrap();
        let sleeper = Arc::new(Sleeper { time, played: Mutex::default() });
        let store = runtime.block_on(Store::of_test(&folder.0)).unwrap();
        runtime.block_on(fill(&store, submissions, each));
        let jobs = (0..services).map(|_| {
            runtime.block_on(async {
                let store = Store::of_test(&folder.0).await.unwrap();
                let service = Arc::new(Service::new(store, ServiceOptions { lease, ..ServiceOptions::default() }));
                Jobs::verify(&service, vec![Arc::<Sleeper>::clone(&sleeper) as Arc<dyn Verifier>], 1).unwrap()
            })
        });
        let jobs: Vec<Jobs> = jobs.collect();
        let start = Instant::now();
        let verified = || runtime.block_on(store.states()).unwrap().iter().all(|count| count.kind == "verified");
        while !verified() {
            assert!(start.elapsed() < Duration::from_secs(60), "{sleeper:?}");
            std::thread::sleep(Duration::from_millis(10));
        }
        jobs.into_iter().for_each(Jobs::stop);
        sleeper.played.lock().unwrap().values().sum()
    }

    /// Guards an episode whose verification outlasts its claim: the claim is renewed, so no other scorer verifies it, too.
    #[test]
    fn a_long_verification_keeps_its_claim() {
        assert_eq!(work("long", (3, 1, 1), Duration::from_millis(1_200), Duration::from_secs(3)), 1);
    }

    /// Servers that come and go, as a test says, and how often each was asked.
    #[derive(Debug, Default)]
    struct Room {
        present: Mutex<Option<Vec<&'static str>>>,
        asked: Arc<Mutex<BTreeMap<&'static str, u64>>>,
    }

    /// Gives each episode back.
    #[derive(Debug)]
    struct Asked(&'static str, Arc<Mutex<BTreeMap<&'static str, u64>>>);

    impl Verifier for Asked {
        fn name(&self) -> &str {
            self.0
        }

        fn version(&self) -> Option<String> {
            None
        }

        fn verify(&self, _: &Path, _: &str, _: &mut u64, _: &AtomicBool) -> VerifyOutcome {
            *self.1.lock().unwrap().entry(self.0).or_default() += 1;
            std::thread::sleep(Duration::from_millis(5));
            VerifyOutcome::Stopped
        }
    }

    impl VerifierGroup for Room {
        fn present(&self) -> Option<Vec<Arc<dyn Verifier>>> {
            let present = self.present.lock().unwrap().clone()?;
            let asked = |name| -> Arc<dyn Verifier> { Arc::new(Asked(name, Arc::clone(&self.asked))) };
            Some(present.into_iter().map(asked).collect())
        }
    }

    impl Room {
        /// Has these servers; a while later those that are expected are asked, and no others.
        fn asks(&self, present: Option<Vec<&'static str>>, expected: &[&str]) {
            *self.present.lock().unwrap() = present;
            let start = Instant::now();
            loop {
                std::thread::sleep(MEMBERS * MISSED);
                self.asked.lock().unwrap().clear();
                std::thread::sleep(LOOK * 4);
                let asked: Vec<&str> = self.asked.lock().unwrap().keys().copied().collect();
                if asked == expected {
                    return;
                }
                assert!(start.elapsed() < Duration::from_secs(30), "{asked:?}, not {expected:?}");
            }
        }
    }

    /// Guards a group: a server that comes is asked without a restart, one that goes no more, and a link that fails changes nothing.
    #[test]
    fn servers_of_a_group_come_and_go() {
        let folder = Folder::new("group");
        let runtime = tokio::runtime::Runtime::new().unwrap();
        let store = runtime.block_on(Store::of_test(&folder.0)).unwrap();
        runtime.block_on(fill(&store, 1, 8));
        let service = Arc::new(Service::new(store, ServiceOptions::default()));
        let room = Arc::new(Room::default());
        let groups: Vec<Arc<dyn VerifierGroup>> = vec![Arc::<Room>::clone(&room)];
        let jobs = runtime
            .block_on(async { Jobs::verify(&service, Verifiers { groups, ..Verifiers::default() }, 1).unwrap() });
        room.asks(Some(vec!["lab-1"]), &["lab-1"]);
        room.asks(Some(vec!["lab-1", "lab-2"]), &["lab-1", "lab-2"]);
        room.asks(Some(vec!["lab-2"]), &["lab-2"]);
        room.asks(None, &["lab-2"]);
        room.asks(Some(Vec::new()), &[]);
        room.asks(Some(vec!["lab-1"]), &["lab-1"]);
        jobs.stop();
    }

    /// Guards that scorers on one store share the work.
    #[test]
    fn several_scorers_verify_nothing_twice() {
        let lease = ServiceOptions::default().lease;
        assert_eq!(work("shared", (4, 6, 4), lease, Duration::from_millis(5)), 24);
    }
}
