//! Carries out a run: manages the episodes that are played, the servers that come and go, and the queries to their
//! ledgers.

mod report;
mod servers;

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError, Sender};
use std::thread::Scope;
use std::time::{Duration, Instant};

use fiatlux_carrier::Declaration;
use fiatlux_proto::keys::{any_alive, server_of};
use fiatlux_proto::v3::refusal::Code;
use fiatlux_proto::v3::{RunInfo, ServerInfo};

use super::calls::Calls;
use super::episodes::{Attempt, AttemptEnd, AttemptEvent, EpisodeLoop, REPORT_PERIOD, TICK, WantedEpisode};
use super::outcome::{RunOutcome, RunProgress};
use super::scheduler::{AttemptFailure, Standing};
use super::{Group, RunError, RunOptions};
use crate::{Client, ClientError, Policy, PolicyError};
use servers::{Build, ServerState, cannot_keep};

/// Longest time for a server to close the run: it waits for clients that are gone.
const FINISHING_TIME: Duration = Duration::from_secs(30);

/// An episode that has run for this long is being played, or its session is being waited for.
const AT_WORK: Duration = Duration::from_secs(2);

/// Time between two requests to a server to close the run.
const FINISHING_PERIOD: Duration = Duration::from_millis(500);

type MakePolicy<'a> = dyn Fn() -> Result<Box<dyn Policy>, PolicyError> + Sync + 'a;

/// Messages to the driver from its threads.
enum Event {
    Token { server: String, is_there: bool },
    JoinReply { server: String, asked: u64, result: Result<Box<(ServerInfo, RunInfo)>, ClientError> },
    StatusReply { server: String, asked: u64, result: Result<Box<RunInfo>, ClientError> },
    Attempt(AttemptEvent),
}

impl From<AttemptEvent> for Event {
    fn from(event: AttemptEvent) -> Self {
        Self::Attempt(event)
    }
}

pub(super) struct RunDriver<'scope, 'env> {
    scope: &'scope Scope<'scope, 'env>,
    calls: Calls<'env>,
    options: &'env RunOptions,
    make_policy: &'env MakePolicy<'env>,
    stop: &'env AtomicBool,
    group: Group,
    /// Has no episodes until a server has accepted the run.
    episodes: EpisodeLoop<'scope, 'env, Event>,
    build: Option<Build>,
    servers: BTreeMap<String, ServerState>,
    finished: bool,
    /// The last error that kept a server from taking part.
    problem: Option<ClientError>,
    /// Time since which nothing has been played, by this client or another.
    idle_since: Instant,
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

impl<'scope, 'env> RunDriver<'scope, 'env> {
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
                // The driver may already be gone.
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
            episodes: EpisodeLoop::new(scope, sender.clone()),
            build: None,
            servers: BTreeMap::new(),
            finished: false,
            problem: None,
            idle_since: Instant::now(),
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
        let played = self.run_loop(progress);
        // Whatever happened, wait for the threads of the episodes: they end soon.
        self.episodes.attempts().for_each(Attempt::break_off);
        while self.episodes.attempts().next().is_some() {
            match self.events.recv_timeout(TICK) {
                Ok(Event::Attempt(AttemptEvent::Over { index, end })) => drop(self.on_over(index, end)),
                Ok(_) | Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => break,
            }
        }
        played?;
        let is_over = self.is_registered() && self.episodes.scheduler.is_over();
        let stopped = self.stop.load(Ordering::Relaxed) && !is_over;
        let is_left = |(standing, _): (&Standing, _)| match standing {
            Standing::Lost => true,
            Standing::Elsewhere => !self.options.is_alone,
            _ => false,
        };
        let may_finish = self.options.give_up_lost || !self.episodes.scheduler.standings().any(is_left);
        if is_over && may_finish && !self.finished {
            self.finish();
        }
        progress(&self.episodes.progress());
        Ok(self.outcome(stopped))
    }

    /// True if a server has accepted the run.
    fn is_registered(&self) -> bool {
        !self.episodes.wanted.is_empty()
    }

    fn run_loop(&mut self, progress: &mut dyn FnMut(&RunProgress)) -> Result<(), RunError> {
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
            if !self.is_registered() {
                self.give_up_joining(start)?;
            } else if self.episodes.scheduler.is_over() && self.is_settled(start.elapsed()) {
                // Tell every server that is present that the run has ended.
                return Ok(());
            }
            if self.episodes.scheduler.has_server() || !self.is_registered() {
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
            if self.is_idle() {
                return Ok(());
            }
            self.miss_servers();
            self.ask_servers();
            for index in self.episodes.scheduler.strays() {
                self.episodes.break_off(index);
            }
            has_begun |= self.is_settled(start.elapsed());
            if has_begun {
                let (calls, make_policy, stop) = (self.calls, self.make_policy, self.stop);
                self.episodes
                    .begin(move |index, attempt, opened| play(calls, index, attempt, make_policy, stop, opened));
            }
            if reported.elapsed() >= REPORT_PERIOD {
                reported = Instant::now();
                progress(&self.episodes.progress());
            }
        }
    }

    fn on(&mut self, event: Event) -> Result<(), RunError> {
        match event {
            Event::Token { server, is_there } => {
                let state = self.servers.entry(server.clone()).or_default();
                state.is_there = is_there;
                // A token that reappears may belong to a new process: query the ledger again.
                state.has_joined = false;
                state.refused &= !is_there;
                state.missing_since = (!is_there).then(Instant::now);
                if !is_there {
                    self.episodes.scheduler.server_is_missed(&server);
                }
            }
            Event::JoinReply { server, asked, result } => {
                self.servers.entry(server.clone()).or_default().is_asked = false;
                match result {
                    Ok(reply) => self.on_joined(&server, asked, &reply.0, &reply.1),
                    Err(error) => {
                        let is_final = matches!(
                            error,
                            ClientError::Refused { .. }
                                | ClientError::Version { .. }
                                | ClientError::UnknownServer { .. }
                        );
                        self.refuse(&server, is_final, error);
                    }
                }
            }
            Event::StatusReply { server, asked, result } => {
                self.servers.entry(server.clone()).or_default().is_asked = false;
                match result {
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
            Event::Attempt(AttemptEvent::Opened(index)) => self.episodes.scheduler.opened(index),
            Event::Attempt(AttemptEvent::Over { index, end }) => self.on_over(index, end)?,
        }
        Ok(())
    }

    fn on_over(&mut self, index: usize, end: AttemptEnd) -> Result<(), RunError> {
        let Some(attempt) = self.episodes.over(index) else { return Ok(()) };
        let (EpisodeLoop { scheduler, wanted, .. }, server) = (&mut self.episodes, &attempt.server);
        match end {
            Ok(_) => scheduler.ended(index),
            Err(ClientError::Policy(error)) if attempt.is_refused() => {
                let task = &wanted[index].task;
                let of_task: Vec<usize> = (0..wanted.len()).filter(|other| wanted[*other].task == *task).collect();
                tracing::warn!("the policy refuses {task}: {error}; its episodes count as failures");
                scheduler.refused_by_policy(index, &of_task, &error.to_string());
                // A policy that fits no session is an error of the call, and nothing is lost by it.
                let is_refused =
                    |(standing, _): (&Standing, _)| [Standing::Unplayable, Standing::Elsewhere].contains(standing);
                if scheduler.standings().all(is_refused) {
                    return Err(error.into());
                }
            }
            Err(error) if cannot_keep(&error) => {
                scheduler.set_back(index, AttemptFailure::BrokenOff);
                self.set_aside(server, error);
            }
            Err(error) => {
                let setback = setback(&error);
                if matches!(setback, AttemptFailure::Held | AttemptFailure::Busy) {
                    self.refusal = Some(error.to_string());
                }
                if !matches!(setback, AttemptFailure::BrokenOff | AttemptFailure::Busy) {
                    let WantedEpisode { task, seed, .. } = &wanted[index];
                    let seed = seed.map_or_else(|| "hosted".into(), |seed| seed.to_string());
                    tracing::debug!("{task} seed {seed} was not played to its end: {error}");
                }
                scheduler.set_back(index, setback);
                if matches!(error, ClientError::Unanswered { .. }) {
                    self.on_silence(server);
                }
            }
        }
        Ok(())
    }

    /// True if nothing has been played for so long that nothing can be expected; notes the reason.
    fn is_idle(&mut self) -> bool {
        let RunProgress { done, lost, .. } = self.episodes.progress();
        let is_at_work = |attempt: &Attempt| attempt.since.elapsed() >= AT_WORK;
        if done + lost != self.decided
            || !self.episodes.scheduler.has_server()
            || self.episodes.attempts().any(is_at_work)
        {
            (self.decided, self.idle_since) = (done + lost, Instant::now());
        }
        if self.idle_since.elapsed() <= self.options.patience {
            return false;
        }
        let reason =
            self.refusal.clone().unwrap_or_else(|| "the servers do not report the outcome of finished episodes".into());
        let ending = format!("nothing could be played for {} s: {reason}", self.options.patience.as_secs());
        tracing::warn!("{ending}");
        self.ending = Some(ending);
        true
    }

    /// Closes the run on all servers.
    fn finish(&mut self) {
        let live: Vec<String> = self.episodes.scheduler.live().map(str::to_owned).collect();
        let asked = self.episodes.scheduler.moment() + 1;
        let start = Instant::now();
        let mut finished = !live.is_empty();
        for server in live {
            let result = loop {
                match self.calls.finish(&server) {
                    // A session that was broken off there is still open.
                    Err(ClientError::Refused { code: Code::Busy, .. })
                        if start.elapsed() < FINISHING_TIME && !self.stop.load(Ordering::Relaxed) =>
                    {
                        std::thread::sleep(FINISHING_PERIOD);
                    }
                    result => break result,
                }
            };
            match result {
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

/// Plays an episode to its end; `opened` is called when its session is open.
fn play(
    calls: Calls<'_>,
    index: usize,
    attempt: &Attempt,
    make_policy: &MakePolicy<'_>,
    stop: &AtomicBool,
    opened: &dyn Fn(),
) -> AttemptEnd {
    // The session does not wait for a policy that is slow to load.
    let mut policy = make_policy()?;
    if attempt.is_broken_off() {
        return Err(ClientError::Stopped);
    }
    let (info, secrets) = calls.open(&attempt.server, index)?;
    opened();
    let client = Client::enter(calls.link, &attempt.server, info, &secrets)?;
    attempt.play(client, policy.as_mut(), stop)
}

/// Consequence of an error for the episode.
fn setback(error: &ClientError) -> AttemptFailure {
    match error {
        ClientError::Stopped => AttemptFailure::BrokenOff,
        ClientError::Refused { code: Code::Busy, field, .. } if field == "open" => AttemptFailure::Held,
        ClientError::Refused { code: Code::Busy, .. } => AttemptFailure::Busy,
        ClientError::Refused { .. } => AttemptFailure::Refused(error.to_string()),
        // A deterministic policy would fail again.
        ClientError::Policy(_) => AttemptFailure::Hopeless(fiatlux_cli::in_full(error)),
        _ => AttemptFailure::Failed(error.to_string()),
    }
}
