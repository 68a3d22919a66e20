//! Carries a run: the threads that play episodes, the servers that come and go, and the questions to their ledgers.

mod play;

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError, Sender};
use std::thread::Scope;
use std::time::{Duration, Instant};

use fiatlux_proto::keys::{any_alive, server_of};
use fiatlux_proto::v3::refusal::Code;
use fiatlux_proto::v3::run_episode::State as Ledger;
use fiatlux_proto::v3::{EpisodeEnd, RunEpisode, RunInfo, ServerInfo};
use zenoh::Wait;
use zenoh::pubsub::Subscriber;
use zenoh::sample::SampleKind;

use super::calls::Calls;
use super::outcome::{EpisodeFate, EpisodeOutcome, Playing, RunOutcome, RunProgress};
use super::scheduler::{Scheduler, Setback, Standing};
use super::{Group, RunError, RunOptions};
use crate::{ClientError, Policy, PolicyError};
use play::{Job, setback};

/// Most episodes at once on a server where nobody says how many: its cores are not known here.
const USUAL_ROOM: usize = 8;

/// A server whose token is missing for so long is gone. A link that comes back sooner costs nothing.
const MISSING_TIME: Duration = Duration::from_secs(2);

/// Between two questions to the same server.
const ASKING_PERIOD: Duration = Duration::from_millis(500);

/// A server that does not take the run within this time, and says nothing against it, is not waited for.
const JOINING_TIME: Duration = Duration::from_secs(15);

/// How long a server may take to end the run: it waits for clients that are gone.
const FINISHING_TIME: Duration = Duration::from_secs(30);

/// Servers that are there at the start are given this time to be heard of, and so long to take the run, so that it is spread
/// over all of them.
const SETTLING_TIMES: [Duration; 2] = [Duration::from_millis(500), Duration::from_secs(3)];

/// Between two looks at everything.
const TICK: Duration = Duration::from_millis(50);

/// Between two reports of progress.
const REPORT_PERIOD: Duration = Duration::from_millis(200);

type MakePolicy<'a> = dyn Fn() -> Result<Box<dyn Policy>, PolicyError> + Sync + 'a;

/// What the crew's threads hear of.
enum Event {
    Token { server: String, is_there: bool },
    Joined { server: String, asked: u64, said: Result<Box<(ServerInfo, RunInfo)>, ClientError> },
    Told { server: String, asked: u64, said: Result<Box<RunInfo>, ClientError> },
    Opened(usize),
    Over { index: usize, steps: u64, end: Result<EpisodeEnd, ClientError> },
}

/// A server of the group.
#[derive(Debug, Default)]
struct Known {
    is_there: bool,
    missing_since: Option<Instant>,
    /// It has taken the run since it was there last.
    has_joined: bool,
    /// It took the run at some time.
    took_part: bool,
    /// It will not take the run, for this reason.
    refused: bool,
    /// A question is under way.
    is_asked: bool,
    asked_at: Option<Instant>,
}

/// What the servers of a run have in common.
#[derive(Debug, PartialEq)]
struct Build {
    version: String,
    model: String,
    scene: String,
}

pub(super) struct Crew<'scope, 'env> {
    scope: &'scope Scope<'scope, 'env>,
    calls: Calls<'env>,
    options: &'env RunOptions,
    make_policy: &'env MakePolicy<'env>,
    stop: &'env AtomicBool,
    group: Group,
    scheduler: Scheduler,
    /// Task and seed of each episode; none until a server has taken the run.
    episodes: Vec<RunEpisode>,
    horizons: BTreeMap<String, u64>,
    build: Option<Build>,
    servers: BTreeMap<String, Known>,
    jobs: BTreeMap<usize, Job>,
    /// Steps of jobs that are over.
    steps: u64,
    finished: bool,
    /// The last thing that kept a server from taking part.
    problem: Option<ClientError>,
    events: Receiver<Event>,
    sender: Sender<Event>,
    _tokens: Subscriber<()>,
}

impl<'scope, 'env> Crew<'scope, 'env> {
    pub(super) fn new(
        scope: &'scope Scope<'scope, 'env>,
        calls: Calls<'env>,
        options: &'env RunOptions,
        make_policy: &'env MakePolicy<'env>,
        group: Group,
        stop: &'env AtomicBool,
    ) -> Result<Self, ClientError> {
        let (sender, events) = mpsc::channel();
        let (tell, members) = (sender.clone(), group.clone());
        let tokens = calls.link.liveliness().declare_subscriber(any_alive()).history(true).callback(move |sample| {
            if let Some(server) = server_of(sample.key_expr().as_str()).filter(|server| members.has(server)) {
                let is_there = sample.kind() == SampleKind::Put;
                // The crew may be gone.
                let _ = tell.send(Event::Token { server: server.into(), is_there });
            }
        });
        Ok(Self {
            scope,
            calls,
            options,
            make_policy,
            stop,
            group,
            scheduler: Scheduler::new(0, 0),
            episodes: Vec::new(),
            horizons: BTreeMap::new(),
            build: None,
            servers: BTreeMap::new(),
            jobs: BTreeMap::new(),
            steps: 0,
            finished: false,
            problem: None,
            events,
            sender,
            _tokens: tokens.wait().map_err(ClientError::zenoh)?,
        })
    }

    /// Plays until nothing is left to do, or nothing can be done.
    pub(super) fn play(mut self, progress: &mut dyn FnMut(&RunProgress)) -> Result<RunOutcome, RunError> {
        let played = self.play_on(progress);
        // Whatever happened, the threads of the jobs are waited for: they end soon.
        self.jobs.values().for_each(Job::break_off);
        while !self.jobs.is_empty() {
            match self.events.recv_timeout(TICK) {
                Ok(Event::Over { index, steps, end }) => drop(self.on_over(index, steps, end)),
                Ok(_) | Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => break,
            }
        }
        played?;
        let is_over = !self.episodes.is_empty() && self.scheduler.is_over();
        let stopped = self.stop.load(Ordering::Relaxed) && !is_over;
        let is_lost = |(standing, _): (&Standing, _)| *standing == Standing::Lost;
        let may_finish = self.options.give_up_lost || !self.scheduler.standings().any(is_lost);
        if is_over && may_finish && !self.finished {
            self.finish();
        }
        progress(&self.look());
        Ok(self.outcome(stopped))
    }

    fn play_on(&mut self, progress: &mut dyn FnMut(&RunProgress)) -> Result<(), RunError> {
        let start = Instant::now();
        let (mut reported, mut last_seen) = (start, start);
        let mut has_begun = false;
        loop {
            match self.events.recv_timeout(TICK) {
                Ok(event) => self.on(event)?,
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return Ok(()),
            }
            while let Ok(event) = self.events.try_recv() {
                self.on(event)?;
            }
            if self.stop.load(Ordering::Relaxed) {
                return Ok(());
            }
            if self.episodes.is_empty() {
                self.give_up_joining(start)?;
            } else if self.scheduler.is_over() {
                return Ok(());
            }
            if self.scheduler.has_server() || self.episodes.is_empty() {
                last_seen = Instant::now();
            } else if last_seen.elapsed() > self.options.patience {
                tracing::warn!("no server has come back within {} s", self.options.patience.as_secs());
                return Ok(());
            }
            self.miss_servers();
            self.ask_servers();
            for index in self.scheduler.strays() {
                self.break_off(index);
            }
            has_begun |= self.is_settled(start.elapsed());
            while has_begun && let Some((index, server)) = self.scheduler.next() {
                self.begin(index, server);
            }
            if reported.elapsed() >= REPORT_PERIOD {
                reported = Instant::now();
                progress(&self.look());
            }
        }
    }

    fn on(&mut self, event: Event) -> Result<(), RunError> {
        match event {
            Event::Token { server, is_there } => {
                let known = self.servers.entry(server.clone()).or_default();
                known.is_there = is_there;
                // A token that is there once more may be that of a new process: the ledger is asked again.
                known.has_joined = false;
                known.refused &= !is_there;
                known.missing_since = (!is_there).then(Instant::now);
                if !is_there {
                    self.scheduler.server_is_missed(&server);
                }
            }
            Event::Joined { server, asked, said } => {
                self.servers.entry(server.clone()).or_default().is_asked = false;
                match said {
                    Ok(said) => self.on_joined(&server, asked, &said.0, &said.1),
                    Err(error) => {
                        let is_final = matches!(error, ClientError::Refused { .. } | ClientError::Version { .. });
                        self.refuse(&server, is_final, error);
                    }
                }
            }
            Event::Told { server, asked, said } => {
                self.servers.entry(server.clone()).or_default().is_asked = false;
                match said {
                    Ok(info) => self.on_ledger(&server, asked, &info),
                    Err(error) => tracing::debug!("server {server} does not say where the run stands: {error}"),
                }
            }
            Event::Opened(index) => self.scheduler.opened(index),
            Event::Over { index, steps, end } => self.on_over(index, steps, end)?,
        }
        Ok(())
    }

    fn on_joined(&mut self, server: &str, asked: u64, info: &ServerInfo, run: &RunInfo) {
        let build =
            Build { version: info.version.clone(), model: info.model_digest.clone(), scene: info.scene_digest.clone() };
        let same_build = self.build.as_ref().is_none_or(|first| *first == build);
        let same_run = |(left, right): (&RunEpisode, &RunEpisode)| left.task == right.task && left.seed == right.seed;
        let same_episodes = self.episodes.is_empty()
            || self.finished
            || self.episodes.len() == run.episodes.len() && self.episodes.iter().zip(&run.episodes).all(same_run);
        if run.episodes.is_empty() || !same_build || !same_episodes {
            let reason = match (same_build, run.episodes.is_empty()) {
                (false, _) => {
                    format!("server {server} is of another version, or has another robot or scene, than the others")
                }
                (_, true) => format!("server {server} says that the run has no episodes"),
                _ => format!("server {server} has other episodes in this run than the others"),
            };
            return self.refuse(server, true, ClientError::Session { reason });
        }
        if self.episodes.is_empty() {
            self.episodes.clone_from(&run.episodes);
            self.scheduler = Scheduler::new(run.episodes.len(), self.options.parallel.unwrap_or(usize::MAX).max(1));
            self.horizons = info.tasks.iter().map(|task| (task.task.clone(), task.horizon_steps)).collect();
            self.build = Some(build);
        }
        let known = self.servers.entry(server.into()).or_default();
        if !known.is_there {
            return;
        }
        if known.took_part {
            tracing::info!("server {server} is back");
        }
        (known.has_joined, known.took_part, known.missing_since) = (true, true, None);
        let capacity = usize::try_from(info.capacity).unwrap_or(usize::MAX);
        let room = if self.options.parallel.is_some() { capacity } else { capacity.min(USUAL_ROOM) };
        self.scheduler.server_joins(server, room);
        self.on_ledger(server, asked, run);
    }

    fn on_ledger(&mut self, server: &str, asked: u64, info: &RunInfo) {
        self.finished |= info.finished;
        if info.finished && info.episodes.len() == self.episodes.len() {
            // Hosted seeds are told at the end.
            self.episodes.clone_from(&info.episodes);
        }
        for index in self.scheduler.told(server, asked, &info.episodes) {
            self.break_off(index);
        }
    }

    fn on_over(&mut self, index: usize, steps: u64, end: Result<EpisodeEnd, ClientError>) -> Result<(), RunError> {
        self.jobs.remove(&index);
        self.steps += steps;
        match end {
            Ok(_) => self.scheduler.ended(index),
            // It fits none of the run's sessions.
            Err(ClientError::Policy(error @ (PolicyError::Sensor { .. } | PolicyError::Unfit { .. }))) => {
                self.scheduler.set_back(index, Setback::BrokenOff);
                return Err(error.into());
            }
            Err(error) => {
                let setback = setback(&error);
                if !matches!(setback, Setback::BrokenOff | Setback::Busy) {
                    let RunEpisode { task, seed, .. } = &self.episodes[index];
                    tracing::debug!("{task} seed {seed} was not played to its end: {error}");
                }
                self.scheduler.set_back(index, setback);
            }
        }
        Ok(())
    }

    /// A server does not take part.
    fn refuse(&mut self, server: &str, is_final: bool, error: ClientError) {
        if is_final {
            self.servers.entry(server.into()).or_default().refused = true;
        }
        if self.episodes.is_empty() {
            self.problem = Some(error);
        } else if is_final {
            tracing::warn!("{error}; it takes no part");
        }
    }

    /// Ends the wait for a first server where none can be expected.
    fn give_up_joining(&mut self, start: Instant) -> Result<(), RunError> {
        let there = || self.servers.values().filter(|known| known.is_there);
        let all_refuse = there().next().is_some() && there().all(|known| known.refused);
        if !all_refuse && start.elapsed() < JOINING_TIME {
            return Ok(());
        }
        let waited_s = start.elapsed().as_secs_f64().round();
        let gone = || ClientError::NotThere { name: self.group.name.clone(), found: Vec::new(), waited_s };
        Err(self.problem.take().unwrap_or_else(gone).into())
    }

    fn is_settled(&self, elapsed: Duration) -> bool {
        let [heard_of, joined] = SETTLING_TIMES;
        let joins = |known: &Known| known.is_there && !known.has_joined && !known.refused;
        elapsed >= heard_of && (elapsed >= joined || !self.servers.values().any(joins))
    }

    fn miss_servers(&mut self) {
        for (name, known) in &mut self.servers {
            if known.missing_since.is_some_and(|since| since.elapsed() >= MISSING_TIME) {
                known.missing_since = None;
                self.scheduler.server_leaves(name);
                if known.took_part {
                    tracing::warn!(
                        "server {name} is gone; what it has not finished is played elsewhere, or when it is back"
                    );
                }
            }
        }
    }

    /// Asks servers to take the run, and ledgers for news.
    fn ask_servers(&mut self) {
        let ledgers = self.scheduler.to_ask();
        let asked = self.scheduler.moment() + 1;
        for (name, known) in &mut self.servers {
            let is_due = known.asked_at.is_none_or(|at| at.elapsed() >= ASKING_PERIOD);
            let joins = !known.has_joined;
            if known.is_asked || known.refused || !known.is_there || !is_due || !(joins || ledgers.contains(name)) {
                continue;
            }
            (known.is_asked, known.asked_at) = (true, Some(Instant::now()));
            let (calls, sender, server, spec) =
                (self.calls, self.sender.clone(), name.clone(), &self.options.file.spec);
            self.scope.spawn(move || {
                let event = if joins {
                    let said = calls.describe(&server).and_then(|info| {
                        let run = calls.register(&server, spec)?;
                        Ok(Box::new((info, run)))
                    });
                    Event::Joined { server, asked, said }
                } else {
                    Event::Told { asked, said: calls.status(&server).map(Box::new), server }
                };
                let _ = sender.send(event);
            });
        }
    }

    fn begin(&mut self, index: usize, server: String) {
        let job = Job { server, broken_off: Arc::default(), step: Arc::new(AtomicU64::new(0)) };
        self.jobs.insert(index, job.clone());
        let (calls, make_policy, sender, stop) = (self.calls, self.make_policy, self.sender.clone(), self.stop);
        self.scope.spawn(move || {
            let end = job.play(calls, index, make_policy, stop, &|| drop(sender.send(Event::Opened(index))));
            let _ = sender.send(Event::Over { index, steps: job.step.load(Ordering::Relaxed), end });
        });
    }

    fn break_off(&self, index: usize) {
        if let Some(job) = self.jobs.get(&index) {
            job.break_off();
        }
    }

    /// Ends the run on all servers.
    fn finish(&mut self) {
        let live: Vec<String> = self.scheduler.live().map(str::to_owned).collect();
        let asked = self.scheduler.moment() + 1;
        let start = Instant::now();
        let mut finished = !live.is_empty();
        for server in live {
            let said = loop {
                match self.calls.finish(&server) {
                    // A session that was broken off there is still open.
                    Err(ClientError::Refused { code: Code::Busy, .. })
                        if start.elapsed() < FINISHING_TIME && !self.stop.load(Ordering::Relaxed) =>
                    {
                        std::thread::sleep(ASKING_PERIOD);
                    }
                    said => break said,
                }
            };
            match said {
                Ok(info) => self.on_ledger(&server, asked, &info),
                Err(error) => {
                    tracing::warn!("the run is not ended on server {server}: {error}");
                    finished = false;
                }
            }
        }
        self.finished = finished;
    }

    fn look(&self) -> RunProgress {
        let mut look = RunProgress {
            episodes: self.episodes.len(),
            steps: self.steps,
            servers: self.scheduler.live().map(str::to_owned).collect(),
            ..RunProgress::default()
        };
        for (index, ((standing, _), episode)) in self.scheduler.standings().zip(&self.episodes).enumerate() {
            let horizon = self.horizons.get(&episode.task).copied().unwrap_or(0);
            match standing {
                Standing::Waiting => look.steps_left += horizon,
                Standing::Playing { server, .. } => {
                    let step = self.jobs.get(&index).map_or(0, |job| job.step.load(Ordering::Relaxed));
                    look.steps += step;
                    look.steps_left += horizon.saturating_sub(step);
                    let (task, seed) = (episode.task.clone(), self.seed(episode));
                    look.playing.push(Playing { task, seed, server: server.clone(), step });
                }
                Standing::Held { .. } => {
                    look.held += 1;
                    look.steps_left += horizon;
                }
                Standing::Ended { .. } => {}
                Standing::Decided { entry, .. } => {
                    look.done += 1;
                    look.successes += usize::from(entry.success);
                }
                Standing::Lost => look.lost += 1,
            }
        }
        look
    }

    fn seed(&self, episode: &RunEpisode) -> Option<u64> {
        (self.finished || self.options.file.spec.hosted_seeds == 0).then_some(episode.seed)
    }

    fn outcome(&self, stopped: bool) -> RunOutcome {
        let outcome = |((standing, problem), episode): ((&Standing, Option<&str>), &RunEpisode)| {
            let mut outcome = EpisodeOutcome {
                task: episode.task.clone(),
                seed: self.seed(episode),
                fate: EpisodeFate::Lost,
                cause: problem.unwrap_or("it was not played").into(),
                success: false,
                digest: String::new(),
                attempts: 0,
                server: None,
            };
            if let Standing::Decided { server, entry } = standing {
                outcome.fate = if entry.state() == Ledger::Played { EpisodeFate::Played } else { EpisodeFate::Failed };
                outcome.cause.clone_from(&entry.cause);
                outcome.digest.clone_from(&entry.digest);
                (outcome.success, outcome.attempts, outcome.server) =
                    (entry.success, entry.attempts, Some(server.clone()));
            }
            outcome
        };
        let took_part = self.servers.iter().filter(|(_, known)| known.took_part);
        RunOutcome {
            run: self.options.file.run.clone(),
            episodes: self.scheduler.standings().zip(&self.episodes).map(outcome).collect(),
            finished: self.finished,
            stopped,
            servers: took_part.map(|(name, _)| name.clone()).collect(),
        }
    }
}
