//! The servers of a run: which are present, which take part, and what their ledgers say.

use std::time::{Duration, Instant};

use fiatlux_proto::v3::refusal::Code;
use fiatlux_proto::v3::run_episode::State as Ledger;
use fiatlux_proto::v3::{RunEpisode, RunInfo, ServerInfo};

use super::super::RunError;
use super::super::scheduler::{Scheduler, Standing};
use super::{Crew, Event};
use crate::ClientError;

/// Largest number of episodes at once on a server if neither side sets one: the client does not know its cores.
const USUAL_ROOM: usize = 8;

/// A server whose token is missing for this long is gone. A link that recovers sooner costs nothing.
const MISSING_TIME: Duration = Duration::from_secs(2);

/// Time between two queries to the same server.
const ASKING_PERIOD: Duration = Duration::from_millis(500);

/// How long to wait for a server that neither accepts nor refuses the run.
const JOINING_TIME: Duration = Duration::from_secs(15);

/// How long to wait at the start for servers to appear, and then for them to accept the run, so that it is spread over
/// all of them.
const SETTLING_TIMES: [Duration; 2] = [Duration::from_millis(500), Duration::from_secs(3)];

/// A server of the group.
#[derive(Debug, Default)]
pub(super) struct Known {
    pub is_there: bool,
    pub missing_since: Option<Instant>,
    /// It has accepted the run since it last appeared.
    pub has_joined: bool,
    /// It accepted the run at some time.
    pub took_part: bool,
    /// It has refused the run for good.
    pub refused: bool,
    /// A query to it is pending.
    pub is_asked: bool,
    asked_at: Option<Instant>,
}

/// What the servers of a run must have in common.
#[derive(Debug, PartialEq)]
pub(super) struct Build {
    version: String,
    model: String,
    scene: String,
}

impl Crew<'_, '_> {
    pub(super) fn on_joined(&mut self, server: &str, asked: u64, info: &ServerInfo, run: &RunInfo) {
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
        self.problem = None;
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

    pub(super) fn on_ledger(&mut self, server: &str, asked: u64, info: &RunInfo) {
        self.finished |= info.finished;
        if info.finished && info.episodes.len() == self.episodes.len() {
            // Hosted seeds are disclosed at the end.
            self.episodes.clone_from(&info.episodes);
        }
        let is_held = |((standing, _), entry): ((&Standing, _), &RunEpisode)| {
            matches!(standing, Standing::Held { server: by } if by == server) && entry.state() == Ledger::Open
        };
        if self.scheduler.standings().zip(&info.episodes).any(is_held) {
            // Another client plays it there.
            self.quiet_since = Instant::now();
        }
        for index in self.scheduler.told(server, asked, &info.episodes) {
            self.break_off(index);
        }
    }

    /// Notes that a server does not take part.
    pub(super) fn refuse(&mut self, server: &str, is_final: bool, error: ClientError) {
        if is_final {
            self.servers.entry(server.into()).or_default().refused = true;
        }
        if self.episodes.is_empty() {
            self.problem = Some(error);
        } else if is_final {
            tracing::warn!("{error}; it does not take part");
        }
    }

    /// Excludes a server that cannot write the run's ledger: nothing that it played would count.
    pub(super) fn set_aside(&mut self, server: &str, error: ClientError) {
        tracing::warn!("{error}; it no longer takes part");
        self.servers.entry(server.into()).or_default().refused = true;
        self.scheduler.server_leaves(server);
        self.problem = Some(error);
    }

    /// Notes that a server does not answer: it gets no new episode until it does.
    pub(super) fn on_silence(&mut self, server: &str) {
        if let Some(known) = self.servers.get_mut(server) {
            known.has_joined = false;
            self.scheduler.server_is_missed(server);
        }
    }

    /// Whether every server has refused for good.
    pub(super) fn all_refuse(&self) -> bool {
        !self.servers.is_empty() && self.servers.values().all(|known| known.refused)
    }

    /// Stops waiting for a first server when none can be expected.
    pub(super) fn give_up_joining(&mut self, start: Instant) -> Result<(), RunError> {
        let there = || self.servers.values().filter(|known| known.is_there);
        let all_refuse = there().next().is_some() && there().all(|known| known.refused);
        if !all_refuse && start.elapsed() < JOINING_TIME {
            return Ok(());
        }
        let waited_s = start.elapsed().as_secs_f64().round();
        let gone = || ClientError::NotThere { name: self.group.name.clone(), found: Vec::new(), waited_s };
        Err(self.problem.take().unwrap_or_else(gone).into())
    }

    pub(super) fn is_settled(&self, elapsed: Duration) -> bool {
        let [heard_of, joined] = SETTLING_TIMES;
        let joins = |known: &Known| known.is_there && !known.has_joined && !known.refused;
        elapsed >= heard_of && (elapsed >= joined || !self.servers.values().any(joins))
    }

    pub(super) fn miss_servers(&mut self) {
        for (name, known) in &mut self.servers {
            if known.missing_since.is_some_and(|since| since.elapsed() >= MISSING_TIME) {
                known.missing_since = None;
                self.scheduler.server_leaves(name);
                if known.took_part {
                    tracing::warn!(
                        "server {name} is gone; its unfinished episodes are played elsewhere, or when it is back"
                    );
                }
            }
        }
    }

    /// Asks servers to accept the run, and queries ledgers for news.
    pub(super) fn ask_servers(&mut self) {
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
}

/// Whether the error means that the server cannot write the run's ledger.
pub(super) fn cannot_keep(error: &ClientError) -> bool {
    matches!(error, ClientError::Refused { code: Code::Busy, field, .. } if field == "journal")
}
