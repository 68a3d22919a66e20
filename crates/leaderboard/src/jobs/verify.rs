//! Verifies episodes by simulating them again, on one or many sim-servers.

use std::io::Read as _;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use fiatlux_bag::Bag;
use fiatlux_cli::in_full;
use fiatlux_client::{Access, ClientError, describe_servers};
use fiatlux_grading::Difference;
use fiatlux_link::{Link, Role};
use fiatlux_rules::{BENCHMARK_VERSION, pins};
use fiatlux_verify::{Verification, VerifyError, verify};
use sha2::{Digest as _, Sha256};
use tokio::runtime::Handle;

use super::Verifier;
use crate::store::{Digest, EpisodeJob, LEASE, Return, Verdict};
use crate::{Service, StoreError};

/// Time between two looks for work of an idle worker.
const LOOK: Duration = Duration::from_millis(250);
/// Minimum and maximum pause of a worker whose server does not answer.
const PAUSES: (Duration, Duration) = (Duration::from_secs(1), Duration::from_secs(60));
/// Pause of an episode after a verification that failed without a verdict.
const LATER: Duration = Duration::from_secs(10);
/// Pause of an episode of another version than the server's.
const OTHER_VERSION: Duration = Duration::from_secs(600);
/// After this many refusals by servers of the bag's own version, a pause between them, an episode cannot be replayed. Before
/// that an operator may be in the middle of an upgrade.
const MAX_REFUSALS: i64 = 3;

/// The worker threads, `parallel` for each server.
#[derive(Debug)]
pub(super) struct Verifiers(Vec<JoinHandle<()>>);

struct Worker {
    service: Arc<Service>,
    runtime: Handle,
    verifier: Verifier,
    access: Arc<Access>,
    stop: Arc<AtomicBool>,
    name: String,
}

enum VerifyOutcome {
    Decided(Verdict, String),
    /// The server or its connection failed, so there is no verdict: try again.
    Again(String),
    /// The server is of another version than the bag, so its word means nothing.
    OtherVersion(String),
    NotTaken(String),
    Stopped,
}

impl Verifiers {
    pub fn start(
        service: &Arc<Service>,
        verifiers: Vec<Verifier>,
        access: Access,
        parallel: usize,
        stop: &Arc<AtomicBool>,
    ) -> std::io::Result<Self> {
        let access = Arc::new(access);
        let mut threads = Vec::new();
        for verifier in verifiers {
            for _ in 0..parallel {
                let place = verifier.link.connect.join(", ");
                let name = verifier.server.as_ref().map_or(place.clone(), |server| format!("{server} at {place}"));
                let worker = Worker {
                    service: Arc::clone(service),
                    runtime: Handle::current(),
                    verifier: verifier.clone(),
                    access: Arc::clone(&access),
                    stop: Arc::clone(stop),
                    name,
                };
                threads.push(std::thread::Builder::new().name("verify".into()).spawn(move || worker.run())?);
            }
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
    fn run(&self) {
        let mut pause = PAUSES.0;
        while !self.stop.load(Ordering::Relaxed) {
            let job = match self.runtime.block_on(self.service.store.claim()) {
                Ok(Some(job)) => job,
                Ok(None) => {
                    self.sleep(LOOK);
                    continue;
                }
                Err(error) => {
                    tracing::error!(error = in_full(&error), "cannot read the next job from the store");
                    self.sleep(PAUSES.1);
                    continue;
                }
            };
            let renewal = self.runtime.spawn(renew(Arc::clone(&self.service), job.clone()));
            let outcome = self.again(&job);
            renewal.abort();
            let is_idle = matches!(outcome, VerifyOutcome::Again(_));
            if let Err(error) = self.take_in(&job, outcome) {
                tracing::error!(error = in_full(&error), "cannot store the outcome of a verification; it is repeated");
                self.sleep(PAUSES.0);
            }
            if is_idle {
                self.sleep(pause);
                pause = (pause * 2).min(PAUSES.1);
            } else {
                pause = PAUSES.0;
            }
        }
    }

    fn sleep(&self, time: Duration) {
        let start = Instant::now();
        while !self.stop.load(Ordering::Relaxed) && start.elapsed() < time {
            std::thread::sleep(time.min(Duration::from_millis(50)));
        }
    }

    fn again(&self, job: &EpisodeJob) -> VerifyOutcome {
        let path = self.service.store.blobs.local(&job.bag);
        let start = Instant::now();
        let mut steps = 0;
        let mut progress = |step, _| steps = step;
        let Verifier { link, server } = &self.verifier;
        // Opened anew for each episode: the server may have been away.
        let link = match link.open(Role::Client) {
            Ok(link) => link,
            Err(error) => return VerifyOutcome::Again(in_full(&error)),
        };
        let done = verify(&path, &link.carrier(), server.as_deref(), &self.access, &mut progress, &self.stop);
        let metrics = &self.service.metrics;
        metrics.verifying_ms.fetch_add(start.elapsed().as_millis() as u64, Ordering::Relaxed);
        metrics.verified_steps.fetch_add(steps, Ordering::Relaxed);
        // Servers of another version may play otherwise, or refuse what was played.
        let is_equal = done.as_ref().is_ok_and(Verification::is_equal);
        let is_of_server =
            done.as_ref().is_err_and(|error| error.is_of_server() || matches!(error, VerifyError::Lost { .. }));
        if !is_equal
            && !is_of_server
            && let Some(reason) = self.other_version(&link, &path)
        {
            return VerifyOutcome::OtherVersion(reason);
        }
        match done {
            Ok(verification) if !verification.is_equal() && has_objects(&path) => {
                // Only a server with the same files can tell.
                match &verification.header {
                    Some(Difference { field, .. }) if field.contains("assets") || field == "scene_digest" => {
                        VerifyOutcome::NotTaken(
                            "the server does not have the bag's objects; start one with --asset for each of them"
                                .into(),
                        )
                    }
                    _ => of_verification(&verification),
                }
            }
            Ok(verification) => of_verification(&verification),
            Err(VerifyError::Client(ClientError::Stopped)) => VerifyOutcome::Stopped,
            // The bag could be read when it was graded: check that it is still the same file.
            Err(error @ (VerifyError::Bag { .. } | VerifyError::Reread(_) | VerifyError::Actions(_)))
            | Err(error @ VerifyError::Client(ClientError::Policy(_))) => match digest_of(&path) {
                Some(digest) if digest == job.bag => {
                    let folder = path.parent().map(|folder| folder.join("").display().to_string()).unwrap_or_default();
                    let reason = in_full(&error).replace(&folder, "").replace(job.bag.as_str(), "the bag");
                    VerifyOutcome::Decided(Verdict::Differs, reason)
                }
                _ => VerifyOutcome::Again(
                    "the bag on disk is not the one that was uploaded; restore it from a backup".into(),
                ),
            },
            Err(error) if error.is_of_server() || matches!(error, VerifyError::Lost { .. }) => {
                VerifyOutcome::Again(in_full(&error))
            }
            Err(VerifyError::Client(ClientError::Refused { field, message, .. })) => {
                VerifyOutcome::NotTaken(format!("{field}: {message}"))
            }
            Err(error) => VerifyOutcome::NotTaken(in_full(&error)),
        }
    }

    /// Why the server cannot judge this bag: it is of another version, or does not say which.
    fn other_version(&self, link: &Link, path: &Path) -> Option<String> {
        let bag = Bag::open(path).ok()?;
        let recorded = &bag.header().version;
        let servers = describe_servers(&link.carrier()).unwrap_or_default();
        let wanted = self.verifier.server.as_deref();
        let info = servers.iter().find(|info| wanted.is_none_or(|wanted| info.server == wanted));
        unfit(recorded, info.map(|info| info.version.as_str()))
    }

    fn take_in(&self, job: &EpisodeJob, outcome: VerifyOutcome) -> Result<(), StoreError> {
        let metrics = &self.service.metrics;
        let decide = |verdict, detail: &str| {
            if self.runtime.block_on(self.service.store.set_verdict(job, verdict, &self.name, detail))? {
                metrics.verified.fetch_add(1, Ordering::Relaxed);
            } else {
                tracing::info!(episode = %job, server = self.name, "it is decided or claimed again; this verdict is not used");
            }
            Ok(())
        };
        let release = |pause, why| self.runtime.block_on(self.service.store.release(job, pause, why));
        match outcome {
            VerifyOutcome::Stopped => release(Duration::ZERO, Return::Unplayed),
            VerifyOutcome::Decided(verdict, detail) => {
                if verdict != Verdict::Equal {
                    tracing::info!(submission = %job.submission, episode = %job, server = self.name, detail, "differs");
                }
                decide(verdict, &detail)
            }
            VerifyOutcome::Again(reason) => {
                metrics.retries.fetch_add(1, Ordering::Relaxed);
                tracing::warn!(episode = %job, server = self.name, reason, "could not be verified; trying again later");
                // An episode that always fails must not hold up the others.
                release(LATER, Return::Unplayed)
            }
            VerifyOutcome::OtherVersion(reason) => {
                metrics.retries.fetch_add(1, Ordering::Relaxed);
                tracing::warn!(episode = %job, server = self.name, reason, "could not be verified; trying again later");
                release(OTHER_VERSION, Return::Unplayed)
            }
            VerifyOutcome::NotTaken(reason) => {
                metrics.retries.fetch_add(1, Ordering::Relaxed);
                tracing::warn!(episode = %job, server = self.name, reason, "the server refuses to play it");
                if job.refusals + 1 < MAX_REFUSALS {
                    return release(self.service.options.refusal_pause, Return::Refused);
                }
                decide(Verdict::Refused, &format!("no server plays it again: {reason}"))
            }
        }
    }
}

/// Renews a claim until it is aborted, or the claim has ended.
async fn renew(service: Arc<Service>, job: EpisodeJob) {
    loop {
        tokio::time::sleep(LEASE / 4).await;
        match service.store.renew(&job).await {
            Ok(true) => {}
            Ok(false) => return,
            Err(error) => tracing::warn!(error = in_full(&error), "cannot renew the claim on an episode"),
        }
    }
}

/// Why a server of this version, if it says which, cannot judge a bag of the other one.
fn unfit(recorded: &str, server: Option<&str>) -> Option<String> {
    match server {
        Some(version) if version == recorded => None,
        Some(version) => Some(format!(
            "the bag was recorded by version {recorded}, the server is version {version}; start one of the bag's version"
        )),
        None => Some("the server does not say which version it is".into()),
    }
}

fn of_verification(verification: &Verification) -> VerifyOutcome {
    if verification.is_equal() {
        return VerifyOutcome::Decided(Verdict::Equal, String::new());
    }
    if let Some(Difference { field, recorded, .. }) = &verification.header
        && is_pinned(field, recorded)
    {
        return VerifyOutcome::Again(format!(
            "the server's {field} is not that of the benchmark; start the server without --scene"
        ));
    }
    let said = |place: String, difference: &Difference| {
        let Difference { field, found, recorded } = difference;
        format!("{place}: {field} is {recorded} in the bag, {found} in the second run")
    };
    let header = verification.header.as_ref().map(|difference| said("header".into(), difference));
    let row = verification.row.as_ref().map(|(step, difference)| said(format!("step {step}"), difference));
    let result = verification.result.as_ref().map(|difference| said("result".into(), difference));
    let ended = || match &verification.simulated {
        None => "the second run did not end at the bag's last step".to_owned(),
        Some(end) => format!("the second run ended by {} at step {}", end.cause, end.steps),
    };
    VerifyOutcome::Decided(Verdict::Differs, row.or(header).or(result).unwrap_or_else(ended))
}

fn has_objects(path: &Path) -> bool {
    Bag::open(path).is_ok_and(|bag| !bag.header().assets.is_empty())
}

/// True if a bag's header has the benchmark's own value of a field. If the second run has another one, the server is
/// not set up for the benchmark, and the bag is not at fault.
fn is_pinned(field: &str, recorded: &str) -> bool {
    match field {
        "model_digest" => pins::RANKED_ROBOTS.into_iter().any(|robot| pins::model(robot) == Some(recorded)),
        "scene_digest" => recorded == pins::SCENE,
        "benchmark_version" => recorded == BENCHMARK_VERSION.to_string(),
        _ => false,
    }
}

fn digest_of(path: &Path) -> Option<Digest> {
    let mut file = std::fs::File::open(path).ok()?;
    let (mut sum, mut block) = (Sha256::new(), vec![0; 1 << 20]);
    loop {
        match file.read(&mut block).ok()? {
            0 => return Some(Digest::from(sum)),
            read => sum.update(&block[..read]),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Guards that refusals and differences of servers of another set-up cost a good run nothing during an upgrade.
    #[test]
    fn only_servers_of_the_bags_version_decide() {
        assert_eq!(unfit("0.7.0", Some("0.7.0")), None);
        assert!(unfit("0.7.0", Some("0.8.0")).is_some_and(|why| why.contains("start one of the bag's version")));
        assert!(unfit("0.7.0", None).is_some());
    }
}
