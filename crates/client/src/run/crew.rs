//! Carries out a run: manages the threads that play episodes, the servers that come and go, and the queries to their
//! ledgers.

mod members;
mod play;
mod report;

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError, Sender};
use std::thread::Scope;
use std::time::{Duration, Instant};

use fiatlux_carrier::Declaration;
use fiatlux_proto::keys::{any_alive, server_of};
use fiatlux_proto::v3::refusal::Code;
use fiatlux_proto::v3::{EpisodeEnd, RunEpisode, RunInfo, ServerInfo};

use super::calls::Calls;
use super::outcome::{RunOutcome, RunProgress};
use super::scheduler::{Scheduler, Setback, Standing};
use super::{Group, RunError, RunOptions};
use crate::{ClientError, Policy, PolicyError};
use members::{Build, Known, cannot_keep};
use play::{Job, setback};

/// Longest time for a server to close the run: it waits for clients that are gone.
const FINISHING_TIME: Duration = Duration::from_secs(30);

/// An episode that has run for this long is being played, or its session is being waited for.
const AT_WORK: Duration = Duration::from_secs(2);

/// Time between two requests to a server to close the run.
const FINISHING_PERIOD: Duration = Duration::from_millis(500);

/// Time between two checks of everything.
const TICK: Duration = Duration::from_millis(50);

/// Time between two reports of progress.
const REPORT_PERIOD: Duration = Duration::from_millis(200);

type MakePolicy<'a> = dyn Fn() -> Result<Box<dyn Policy>, PolicyError> + Sync + 'a;

/// Messages to the crew from its threads.
enum Event {
    Token { server: String, is_there: bool },
    Joined { server: String, asked: u64, said: Result<Box<(ServerInfo, RunInfo)>, ClientError> },
    Told { server: String, asked: u64, said: Result<Box<RunInfo>, ClientError> },
    Opened(usize),
    Over { index: usize, steps: u64, end: Result<EpisodeEnd, ClientError> },
}

pub(super) struct Crew<'scope, 'env> {
    scope: &'scope Scope<'scope, 'env>,
    calls: Calls<'env>,
    options: &'env RunOptions,
    make_policy: &'env MakePolicy<'env>,
    stop: &'env AtomicBool,
    group: Group,
    scheduler: Scheduler,
    /// Task and seed of each episode; empty until a server has accepted the run.
    episodes: Vec<RunEpisode>,
    horizons: BTreeMap<String, u64>,
    build: Option<Build>,
    servers: BTreeMap<String, Known>,
    jobs: BTreeMap<usize, Job>,
    /// Steps of finished jobs.
    steps: u64,
    finished: bool,
    /// The last error that kept a server from taking part.
    problem: Option<ClientError>,
    /// Time since which nothing has been played, by this client or another.
    quiet_since: Instant,
    /// Number of episodes decided or given up at that time.
    decided: usize,
    /// Why the last episode was not opened.
    refusal: Option<String>,
    /// Why the remaining episodes were not played.
    ending: Option<String>,
    events: Receiver<Event>,
    sender: Sender<Event>,
    _tokens: Declaration,
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
        let tokens = calls.link.watch_tokens(&any_alive(), move |key, is_there| {
            if let Some(server) = server_of(key).filter(|server| members.has(server)) {
                // The crew may already be gone.
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
            quiet_since: Instant::now(),
            decided: 0,
            refusal: None,
            ending: None,
            events,
            sender,
            _tokens: tokens?,
        })
    }

    /// Plays until nothing is left to do, or nothing can be done.
    pub(super) fn play(mut self, progress: &mut dyn FnMut(&RunProgress)) -> Result<RunOutcome, RunError> {
        let played = self.play_on(progress);
        // Whatever happened, wait for the threads of the jobs: they end soon.
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
            } else if self.scheduler.is_over() && self.is_settled(start.elapsed()) {
                // Tell every server that is present that the run has ended.
                return Ok(());
            }
            if self.scheduler.has_server() || self.episodes.is_empty() {
                last_seen = Instant::now();
            } else if self.all_refuse() {
                self.ending = self.problem.as_ref().map(ToString::to_string);
                return Ok(());
            } else if last_seen.elapsed() > self.options.patience {
                let ending = format!("no server has come back within {} s", self.options.patience.as_secs());
                tracing::warn!("{ending}");
                self.ending = Some(ending);
                return Ok(());
            }
            if self.is_quiet() {
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
                // A token that reappears may belong to a new process: query the ledger again.
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
                    Err(error) if cannot_keep(&error) => self.set_aside(&server, error),
                    Err(error) => {
                        tracing::debug!("cannot get the state of the run from server {server}: {error}");
                        if matches!(error, ClientError::Unanswered { .. }) {
                            self.on_silence(&server);
                        }
                    }
                }
            }
            Event::Opened(index) => self.scheduler.opened(index),
            Event::Over { index, steps, end } => self.on_over(index, steps, end)?,
        }
        Ok(())
    }

    fn on_over(&mut self, index: usize, steps: u64, end: Result<EpisodeEnd, ClientError>) -> Result<(), RunError> {
        let server = self.jobs.remove(&index).map(|job| job.server).unwrap_or_default();
        self.steps += steps;
        match end {
            Ok(_) => self.scheduler.ended(index),
            Err(ClientError::Policy(error @ (PolicyError::Sensor { .. } | PolicyError::Unfit { .. }))) => {
                let task = &self.episodes[index].task;
                let of_task: Vec<usize> =
                    (0..self.episodes.len()).filter(|other| self.episodes[*other].task == *task).collect();
                tracing::warn!("the policy refuses {task}: {error}; its episodes count as failures");
                self.scheduler.refused_by_policy(index, &of_task, &error.to_string());
                // A policy that fits no session is an error of the call, and nothing is lost by it.
                if self.scheduler.standings().all(|(standing, _)| *standing == Standing::Unplayable) {
                    return Err(error.into());
                }
            }
            Err(error) if cannot_keep(&error) => {
                self.scheduler.set_back(index, Setback::BrokenOff);
                self.set_aside(&server, error);
            }
            Err(error) => {
                let setback = setback(&error);
                if matches!(setback, Setback::Held | Setback::Busy) {
                    self.refusal = Some(error.to_string());
                }
                if !matches!(setback, Setback::BrokenOff | Setback::Busy) {
                    let RunEpisode { task, seed, .. } = &self.episodes[index];
                    tracing::debug!("{task} seed {seed} was not played to its end: {error}");
                }
                self.scheduler.set_back(index, setback);
                if matches!(error, ClientError::Unanswered { .. }) {
                    self.on_silence(&server);
                }
            }
        }
        Ok(())
    }

    /// Whether nothing has been played for so long that nothing can be expected; notes the reason.
    fn is_quiet(&mut self) -> bool {
        let look = self.look();
        let is_at_work = |job: &Job| job.since.elapsed() >= AT_WORK;
        if look.done + look.lost != self.decided || !self.scheduler.has_server() || self.jobs.values().any(is_at_work) {
            (self.decided, self.quiet_since) = (look.done + look.lost, Instant::now());
        }
        if self.quiet_since.elapsed() <= self.options.patience {
            return false;
        }
        let reason =
            self.refusal.clone().unwrap_or_else(|| "the servers do not report the outcome of finished episodes".into());
        let ending = format!("nothing could be played for {} s: {reason}", self.options.patience.as_secs());
        tracing::warn!("{ending}");
        self.ending = Some(ending);
        true
    }

    fn begin(&mut self, index: usize, server: String) {
        let job = Job { server, since: Instant::now(), broken_off: Arc::default(), step: Arc::new(AtomicU64::new(0)) };
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

    /// Closes the run on all servers.
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
                        std::thread::sleep(FINISHING_PERIOD);
                    }
                    said => break said,
                }
            };
            match said {
                Ok(info) => self.on_ledger(&server, asked, &info),
                Err(error) => {
                    tracing::warn!("cannot close the run on server {server}: {error}");
                    finished = false;
                }
            }
        }
        self.finished = finished;
    }
}
