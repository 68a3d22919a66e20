//! Decides which episode to open next, and on which server. It does no I/O and reads no clock: the caller reports
//! events.

use std::collections::BTreeMap;

use fiatlux_proto::v3::RunEpisode;
use fiatlux_proto::v3::run_episode::State as Ledger;

/// Number of failures after which an episode is given up.
pub(super) const MAX_TRIES: u32 = 3;

/// The state of an episode.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Standing {
    /// Not open on any server.
    Waiting,
    /// This client plays it on that server since that moment, or is about to.
    Playing { server: String, since: u64 },
    /// Open on that server for another client: one that died, or one that plays the same run at the same time.
    Held { server: String },
    /// This client played it to its end at that moment; the server has not yet confirmed that it is on disk.
    Ended { server: String, since: u64 },
    /// Played or failed according to a server's ledger.
    Decided { server: String, entry: RunEpisode },
    /// Given up for now.
    Lost,
    /// The policy refuses to play it: a failure when the run is closed.
    Unplayable,
    /// Another shard plays it.
    Elsewhere,
}

/// Why an episode that was handed out was not played to its end.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum AttemptFailure {
    /// The server has no room for it.
    Busy,
    /// It is open there for another client.
    Held,
    /// This client broke it off.
    BrokenOff,
    /// The server refuses to open it, for this reason; its ledger says more.
    Refused(String),
    /// It failed in a way that may not recur.
    Failed(String),
    /// It would fail again.
    Hopeless(String),
}

#[derive(Debug, Clone)]
struct Episode {
    standing: Standing,
    tries: u32,
    /// The server on which it was last begun, which can compare the rows of a new attempt with those of the old one.
    home: Option<String>,
    /// The only server that plays it, where servers share a run and no folder.
    owner: Option<String>,
    problem: Option<String>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Presence {
    Live,
    /// Its token is missing for the moment: it gets no new episodes, and keeps its current ones.
    Missing,
    Gone,
}

#[derive(Debug, Clone)]
struct Server {
    presence: Presence,
    /// Number of episodes that it offers to play at once for this client.
    full_room: usize,
    /// Number that it accepted without being too busy; it grows again with each episode that ends.
    room: usize,
}

/// The episodes of a run, and the servers that play them.
#[derive(Debug, Clone)]
pub(super) struct Scheduler {
    episodes: Vec<Episode>,
    servers: BTreeMap<String, Server>,
    /// Largest number of episodes at once.
    parallel: usize,
    /// Counts the episodes that this client begins and ends, to recognise answers that are out of date.
    moment: u64,
}

impl Scheduler {
    pub(super) fn new(episodes: usize, parallel: usize) -> Self {
        let episode = Episode { standing: Standing::Waiting, tries: 0, home: None, owner: None, problem: None };
        Self { episodes: vec![episode; episodes], servers: BTreeMap::new(), parallel, moment: 0 }
    }

    /// Leaves all episodes but these to other shards.
    pub(super) fn keep_only(&mut self, is_own: impl Fn(usize) -> bool) {
        for (_, episode) in self.episodes.iter_mut().enumerate().filter(|(index, _)| !is_own(*index)) {
            episode.standing = Standing::Elsewhere;
        }
    }

    /// A server has appeared or reappeared.
    pub(super) fn server_joins(&mut self, name: &str, room: usize) {
        self.servers
            .insert(name.into(), Server { presence: Presence::Live, full_room: room.max(1), room: room.max(1) });
    }

    /// A server is missing for the moment.
    pub(super) fn server_is_missed(&mut self, name: &str) {
        if let Some(server) = self.servers.get_mut(name) {
            server.presence = Presence::Missing;
        }
    }

    /// A server is gone. Episodes that it has not confirmed may be played elsewhere.
    pub(super) fn server_leaves(&mut self, name: &str) {
        let Some(server) = self.servers.get_mut(name) else { return };
        server.presence = Presence::Gone;
        for episode in &mut self.episodes {
            if let Standing::Held { server } | Standing::Ended { server, .. } = &episode.standing
                && server == name
            {
                episode.standing = Standing::Waiting;
            }
        }
    }

    /// The current moment, for [`Scheduler::merge_ledger`].
    pub(super) fn moment(&self) -> u64 {
        self.moment
    }

    /// Takes in the ledger of a server, as an answer to a query of that moment. Returns the episodes to break off:
    /// those that this client plays but the server does not, or that are decided elsewhere.
    pub(super) fn merge_ledger(&mut self, name: &str, asked: u64, ledger: &[RunEpisode]) -> Vec<usize> {
        let mut broken_off = Vec::new();
        for (index, (episode, entry)) in self.episodes.iter_mut().zip(ledger).enumerate() {
            if entry.state() == Ledger::Unspecified && !entry.server.is_empty() {
                // Its own ledger decides.
                episode.owner = Some(entry.server.clone());
                continue;
            }
            if episode.owner.as_deref().is_some_and(|owner| owner != name) {
                continue;
            }
            // Servers that share a folder list each other's episodes.
            let by = if entry.server.is_empty() { name } else { &entry.server };
            let decided = Standing::Decided { server: by.into(), entry: entry.clone() };
            match (entry.state(), &episode.standing) {
                (Ledger::Played, Standing::Decided { entry, .. }) if entry.state() == Ledger::Played => {}
                (Ledger::Played, standing) => {
                    if matches!(standing, Standing::Playing { server, .. } if server != name) {
                        broken_off.push(index);
                    }
                    episode.standing = decided;
                }
                // A failure counts for less than an episode that is being played elsewhere.
                (Ledger::Failed, Standing::Decided { .. }) => {}
                (Ledger::Failed, Standing::Playing { server, .. } | Standing::Ended { server, .. })
                    if server != name => {}
                (Ledger::Failed, _) => episode.standing = decided,
                (Ledger::Open, Standing::Waiting) => episode.standing = Standing::Held { server: name.into() },
                (Ledger::Open, _) => {}
                (Ledger::Unspecified, Standing::Held { server }) if server == name => {
                    episode.standing = Standing::Waiting;
                    episode.home = Some(name.into());
                }
                (Ledger::Unspecified, Standing::Playing { server, since }) if server == name && *since < asked => {
                    broken_off.push(index);
                }
                (Ledger::Unspecified, Standing::Ended { server, since }) if server == name && *since < asked => {
                    episode.fail(format!("server {name} could not record it whole"));
                }
                (Ledger::Unspecified, _) => {}
            }
        }
        broken_off
    }

    /// The next episode to open, and the server: the first of those with the fewest failures, on the server where it
    /// was begun, else on the one with the smallest share of its room in use. From now on it counts as being played.
    pub(super) fn next(&mut self) -> Option<(usize, String)> {
        if self.playing().count() >= self.parallel {
            return None;
        }
        let can_begin = |(_, episode): &(usize, &Episode)| {
            episode.standing == Standing::Waiting && episode.owner.as_ref().is_none_or(|owner| self.has_room(owner))
        };
        let waiting = self.episodes.iter().enumerate().filter(can_begin);
        let (index, episode) = waiting.min_by_key(|(index, episode)| (episode.tries, *index))?;
        let mut loads: BTreeMap<&str, usize> = BTreeMap::new();
        for (_, server) in self.playing() {
            *loads.entry(server).or_default() += 1;
        }
        let load = |name: &str| loads.get(name).copied().unwrap_or(0);
        let has_room = |(name, server): &(&String, &Server)| server.is_live() && load(name) < server.room;
        let home = episode.owner.as_ref().or(episode.home.as_ref());
        let home = home.and_then(|home| self.servers.get_key_value(home));
        let least = || {
            let free = self.servers.iter().filter(has_room);
            free.min_by(|(a, left), (b, right)| (load(a) * right.room).cmp(&(load(b) * left.room)))
        };
        let (name, _) = home.filter(has_room).or_else(least)?;
        let name = name.clone();
        self.moment += 1;
        self.episodes[index].standing = Standing::Playing { server: name.clone(), since: u64::MAX };
        Some((index, name))
    }

    /// True if a server is live and takes one more episode.
    fn has_room(&self, name: &str) -> bool {
        let load = self.playing().filter(|(_, server)| *server == name).count();
        self.servers.get(name).is_some_and(|server| server.is_live() && load < server.room)
    }

    /// The session of an episode is open.
    pub(super) fn opened(&mut self, index: usize) {
        self.moment += 1;
        if let Standing::Playing { server, since } = &mut self.episodes[index].standing {
            *since = self.moment;
            self.episodes[index].home = Some(server.clone());
        }
    }

    /// An episode was played to its end.
    pub(super) fn ended(&mut self, index: usize) {
        self.moment += 1;
        let standing = &mut self.episodes[index].standing;
        if let Standing::Playing { server, .. } = standing {
            let server = std::mem::take(server);
            if let Some(server) = self.servers.get_mut(&server) {
                server.room = (server.room + 1).min(server.full_room);
            }
            *standing = Standing::Ended { server, since: self.moment };
        }
    }

    /// An episode was played to its end where there is no ledger to confirm it.
    pub(super) fn played(&mut self, index: usize, success: bool) {
        self.ended(index);
        if let Standing::Ended { server, .. } = &mut self.episodes[index].standing {
            let (server, entry) = (std::mem::take(server), RunEpisode { success, ..RunEpisode::default() });
            self.episodes[index].standing = Standing::Decided { server, entry };
        }
    }

    /// An episode was not played to its end.
    pub(super) fn set_back(&mut self, index: usize, setback: AttemptFailure) {
        let busy = self.playing().count();
        let Some(episode) = self.episodes.get_mut(index) else { return };
        let Standing::Playing { server, .. } = &episode.standing else { return };
        let server = server.clone();
        let is_live = self.servers.get(&server).is_some_and(Server::is_live);
        match setback {
            // The failure is the server's, not the episode's.
            AttemptFailure::Busy | AttemptFailure::Held | AttemptFailure::Refused(_) | AttemptFailure::Failed(_)
                if !is_live =>
            {
                episode.standing = Standing::Waiting;
            }
            AttemptFailure::Busy => {
                episode.standing = Standing::Waiting;
                let load = self.playing().filter(|(_, name)| *name == server).count();
                if let Some(server) = self.servers.get_mut(&server) {
                    server.room = load.max(1);
                }
                // With no other episode under way, none will end and make room: query the ledger first.
                if busy <= 1 {
                    self.episodes[index].standing = Standing::Held { server };
                }
            }
            AttemptFailure::Held => episode.standing = Standing::Held { server },
            AttemptFailure::BrokenOff => episode.standing = Standing::Waiting,
            AttemptFailure::Refused(reason) => {
                episode.fail(reason);
                if episode.standing == Standing::Waiting {
                    episode.standing = Standing::Held { server };
                }
            }
            AttemptFailure::Failed(reason) => episode.fail(reason),
            AttemptFailure::Hopeless(reason) => {
                episode.standing = Standing::Lost;
                episode.problem = Some(reason);
            }
        }
    }

    /// The policy refuses an episode, and so all those of its task that are still to be opened.
    pub(super) fn refused_by_policy(&mut self, index: usize, of_task: &[usize], reason: &str) {
        for &other in of_task {
            let episode = &mut self.episodes[other];
            if other == index || episode.standing == Standing::Waiting {
                (episode.standing, episode.problem) = (Standing::Unplayable, Some(reason.into()));
            }
        }
    }

    /// Episodes on a server that is gone while another one is present: they are to be broken off.
    pub(super) fn strays(&self) -> Vec<usize> {
        if !self.has_server() {
            return Vec::new();
        }
        let is_gone = |name: &str| self.servers.get(name).is_none_or(|server| server.presence == Presence::Gone);
        self.playing().filter(|(_, server)| is_gone(server)).map(|(index, _)| index).collect()
    }

    /// Servers whose ledger may have news.
    pub(super) fn to_ask(&self) -> Vec<String> {
        let asks = |name: &str| {
            self.episodes.iter().any(|episode| match &episode.standing {
                Standing::Held { server } | Standing::Ended { server, .. } => server == name,
                _ => false,
            })
        };
        let live = self.servers.iter().filter(|(_, server)| server.is_live());
        live.map(|(name, _)| name.clone()).filter(|name| asks(name)).collect()
    }

    /// True if a server is live.
    pub(super) fn has_server(&self) -> bool {
        self.servers.values().any(Server::is_live)
    }

    /// True if each episode is decided, given up or left to another shard.
    pub(super) fn is_over(&self) -> bool {
        let is_over = |episode: &Episode| {
            matches!(
                episode.standing,
                Standing::Decided { .. } | Standing::Lost | Standing::Unplayable | Standing::Elsewhere
            )
        };
        self.episodes.iter().all(is_over)
    }

    /// The state of each episode, and its last problem.
    pub(super) fn standings(&self) -> impl Iterator<Item = (&Standing, Option<&str>)> {
        self.episodes.iter().map(|episode| (&episode.standing, episode.problem.as_deref()))
    }

    /// Names of the servers that are present.
    pub(super) fn live(&self) -> impl Iterator<Item = &str> {
        self.servers.iter().filter(|(_, server)| server.is_live()).map(|(name, _)| name.as_str())
    }

    fn playing(&self) -> impl Iterator<Item = (usize, &str)> {
        self.episodes.iter().enumerate().filter_map(|(index, episode)| match &episode.standing {
            Standing::Playing { server, .. } => Some((index, server.as_str())),
            _ => None,
        })
    }
}

impl Server {
    fn is_live(&self) -> bool {
        self.presence == Presence::Live
    }
}

impl Episode {
    fn fail(&mut self, reason: String) {
        self.tries += 1;
        self.problem = Some(reason);
        self.standing = if self.tries < MAX_TRIES { Standing::Waiting } else { Standing::Lost };
    }
}

#[cfg(test)]
mod tests;
