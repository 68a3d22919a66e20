//! The servers of a run: which are present, which take part, and what their ledgers say.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use fiatlux_proto::v3::refusal::Code;
use fiatlux_proto::v3::run_episode::State as Ledger;
use fiatlux_proto::v3::{RunEpisode, RunInfo, ServerInfo};

use super::super::RunError;
use super::super::episodes::WantedEpisode;
use super::super::scheduler::Standing;
use super::{Event, RunDriver};
use crate::ClientError;

/// Largest number of episodes at once on a server if neither side sets one: the client does not know its cores.
const USUAL_ROOM: usize = 8;

/// A server whose token is missing for this long is gone. A link that recovers sooner costs nothing.
const MISSING_TIME: Duration = Duration::from_secs(2);

/// Time between two queries to the same server.
const ASKING_PERIOD: Duration = Duration::from_millis(500);

/// Time to wait for a server that neither accepts nor refuses the run.
const JOINING_TIME: Duration = Duration::from_secs(15);

/// Times to wait at the start for servers to appear, and then for them to accept the run, so that it is spread over all of
/// them.
const SETTLING_TIMES: [Duration; 2] = [Duration::from_millis(500), Duration::from_secs(3)];

/// A server of the group.
#[derive(Debug, Default)]
pub(super) struct ServerState {
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
    /// Why it does not take part, and whether the log has that.
    reason: Option<String>,
    is_told: bool,
}

/// Build properties that all servers of a run must share.
#[derive(Debug, PartialEq)]
pub(super) struct Build {
    version: String,
    model: String,
    scene: String,
}

impl RunDriver<'_, '_> {
    pub(super) fn on_joined(&mut self, server: &str, asked: u64, info: &ServerInfo, run: &RunInfo) {
        let build =
            Build { version: info.version.clone(), model: info.model_digest.clone(), scene: info.scene_digest.clone() };
        let is_unshared = |episode: &RunEpisode| episode.server.is_empty() || episode.state() != Ledger::Unspecified;
        let is_hosted = self.options.file.spec.hosted_seeds > 0;
        if is_hosted && self.options.shares_seeds && run.episodes.iter().all(is_unshared) {
            let reason =
                format!("server {server} has hosted seeds of its own; start it with --seed-key and --seed-group");
            return self.refuse(server, true, ClientError::Session { reason });
        }
        let same_build = self.build.as_ref().is_none_or(|first| *first == build);
        let wanted = self.wanted(info, run);
        let same_episodes = !self.is_registered() || self.finished || self.episodes.wanted == wanted;
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
        if !self.is_registered() {
            self.episodes.want(wanted, self.options.parallel.unwrap_or(usize::MAX).max(1));
            if let Some(shard) = self.options.shard {
                self.episodes.scheduler.keep_only(|index| shard.has(index));
            }
            self.build = Some(build);
            self.tell_of_refusals();
        }
        let state = self.servers.entry(server.into()).or_default();
        if !state.is_there {
            return;
        }
        if state.took_part {
            tracing::info!("server {server} is back");
        }
        (state.has_joined, state.took_part, state.missing_since) = (true, true, None);
        let capacity = usize::try_from(info.capacity).unwrap_or(usize::MAX);
        let room = if self.options.parallel.is_some() { capacity } else { capacity.min(USUAL_ROOM) };
        self.episodes.scheduler.server_joins(server, room);
        self.on_ledger(server, asked, run);
    }

    fn wanted(&self, info: &ServerInfo, run: &RunInfo) -> Vec<WantedEpisode> {
        let horizons: BTreeMap<&str, u64> =
            info.tasks.iter().map(|task| (task.task.as_str(), task.horizon_steps)).collect();
        let is_hosted = self.options.file.spec.hosted_seeds > 0;
        let wanted = |episode: &RunEpisode| WantedEpisode {
            task: episode.task.clone(),
            seed: (!is_hosted).then_some(episode.seed),
            horizon_steps: horizons.get(episode.task.as_str()).copied().unwrap_or(0),
        };
        run.episodes.iter().map(wanted).collect()
    }

    pub(super) fn on_ledger(&mut self, server: &str, asked: u64, info: &RunInfo) {
        self.finished |= info.finished;
        if info.finished && info.episodes.len() == self.episodes.wanted.len() {
            // Hosted seeds are disclosed at the end, each by a server that plays it.
            let is_hosted = self.options.file.spec.hosted_seeds > 0;
            for (wanted, episode) in self.episodes.wanted.iter_mut().zip(&info.episodes) {
                if !is_hosted || episode.seed > 0 {
                    wanted.seed = Some(episode.seed);
                }
            }
        }
        let is_held = |((standing, _), entry): ((&Standing, _), &RunEpisode)| {
            matches!(standing, Standing::Held { server: by } if by == server) && entry.state() == Ledger::Open
        };
        if self.episodes.scheduler.standings().zip(&info.episodes).any(is_held) {
            // Another client plays it there.
            self.idle_since = Instant::now();
        }
        for index in self.episodes.scheduler.merge_ledger(server, asked, &info.episodes) {
            self.episodes.break_off(index);
        }
    }

    /// Notes that a server does not take part. What may pass is told too: a server that plays nothing is not left out
    /// silently. As long as none takes part, the error is that of the whole run.
    pub(super) fn refuse(&mut self, server: &str, is_final: bool, error: ClientError) {
        let state = self.servers.entry(server.into()).or_default();
        state.refused |= is_final;
        let when = if is_final { "" } else { " yet" };
        let reason = format!("{error}; server {server} does not take part{when}");
        if state.reason.as_ref() != Some(&reason) {
            (state.reason, state.is_told) = (Some(reason), false);
        }
        if self.is_registered() {
            self.tell_of_refusals();
        } else {
            self.problem = Some(error);
        }
    }

    /// Logs why servers do not take part, once.
    fn tell_of_refusals(&mut self) {
        for state in self.servers.values_mut().filter(|state| !state.is_told) {
            if let Some(reason) = &state.reason {
                state.is_told = true;
                tracing::warn!("{reason}");
            }
        }
    }

    /// Excludes a server that cannot write the run's ledger: nothing that it played would count.
    pub(super) fn set_aside(&mut self, server: &str, error: ClientError) {
        tracing::warn!("{error}; it no longer takes part");
        self.servers.entry(server.into()).or_default().refused = true;
        self.episodes.scheduler.server_leaves(server);
        self.problem = Some(error);
    }

    /// Notes that a server does not answer: it gets no new episode until it does.
    pub(super) fn on_silence(&mut self, server: &str) {
        if let Some(state) = self.servers.get_mut(server) {
            state.has_joined = false;
            self.episodes.scheduler.server_is_missed(server);
        }
    }

    /// True if every server has refused for good.
    pub(super) fn all_refuse(&self) -> bool {
        !self.servers.is_empty() && self.servers.values().all(|state| state.refused)
    }

    /// Stops waiting for a first server when none can be expected.
    pub(super) fn give_up_joining(&mut self, start: Instant) -> Result<(), RunError> {
        let there = || self.servers.values().filter(|state| state.is_there);
        let all_refuse = there().next().is_some() && there().all(|state| state.refused);
        if !all_refuse && start.elapsed() < JOINING_TIME {
            return Ok(());
        }
        let waited_s = start.elapsed().as_secs_f64().round();
        let gone = || ClientError::NotThere { name: self.group.name.clone(), found: Vec::new(), waited_s };
        Err(self.problem.take().unwrap_or_else(gone).into())
    }

    pub(super) fn is_settled(&self, elapsed: Duration) -> bool {
        let [heard_of, joined] = SETTLING_TIMES;
        let joins = |state: &ServerState| state.is_there && !state.has_joined && !state.refused;
        elapsed >= heard_of && (elapsed >= joined || !self.servers.values().any(joins))
    }

    pub(super) fn miss_servers(&mut self) {
        for (name, state) in &mut self.servers {
            if state.missing_since.is_some_and(|since| since.elapsed() >= MISSING_TIME) {
                state.missing_since = None;
                self.episodes.scheduler.server_leaves(name);
                if state.took_part {
                    tracing::warn!(
                        "server {name} is gone; its unfinished episodes are played elsewhere, or when it is back"
                    );
                }
            }
        }
    }

    /// Asks servers to accept the run, and queries ledgers for news.
    pub(super) fn ask_servers(&mut self) {
        let ledgers = self.episodes.scheduler.to_ask();
        let asked = self.episodes.scheduler.moment() + 1;
        for (name, state) in &mut self.servers {
            let is_due = state.asked_at.is_none_or(|at| at.elapsed() >= ASKING_PERIOD);
            let joins = !state.has_joined;
            if state.is_asked || state.refused || !state.is_there || !is_due || !(joins || ledgers.contains(name)) {
                continue;
            }
            (state.is_asked, state.asked_at) = (true, Some(Instant::now()));
            let (calls, sender, server, spec) =
                (self.calls, self.sender.clone(), name.clone(), &self.options.file.spec);
            self.scope.spawn(move || {
                let event = if joins {
                    let result = calls.describe(&server).and_then(|info| {
                        let run = calls.register(&server, spec)?;
                        Ok(Box::new((info, run)))
                    });
                    Event::JoinReply { server, asked, result }
                } else {
                    Event::StatusReply { asked, result: calls.status(&server).map(Box::new), server }
                };
                let _ = sender.send(event);
            });
        }
    }
}

/// True if the error means that the server cannot write the run's ledger.
pub(super) fn cannot_keep(error: &ClientError) -> bool {
    matches!(error, ClientError::Refused { code: Code::Busy, field, .. } if field == "journal")
}
