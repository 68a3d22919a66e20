//! A run: one policy through the whole benchmark, on one or several servers.

mod calls;
mod driver;
mod episodes;
mod file;
mod outcome;
mod scheduler;

use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

use fiatlux_carrier::Carrier;
use fiatlux_rules::Task;
use thiserror::Error;

use crate::client::{DISCOVERY_S, live_servers};
use crate::{Access, Client, ClientError, Policy, PolicyError, Shard, check_tasks, find_server};
use calls::{Calls, Links};
use driver::RunDriver;
pub use episodes::{Attempt, AttemptEnd, WantedEpisode, play_each};
pub use file::{RunFile, RunFileError};
pub use outcome::{EpisodeFate, EpisodeOutcome, Playing, RunOutcome, RunProgress};

/// Options of a run.
#[derive(Debug, Clone)]
pub struct RunOptions {
    /// Name, key and contents of the run, see [`RunFile::open`].
    pub file: RunFile,
    /// Name of the server, or of a group: `lab` stands for the servers `lab`, `lab-1`, `lab-west` and so on. `None` for
    /// the only server.
    pub server: Option<String>,
    /// Episodes to play at once, over all servers; `None` for as many as the servers accept, but at most eight on each.
    pub parallel: Option<usize>,
    /// Closes the run even if episodes could not be played. They then count as failures and can no longer be played.
    pub give_up_lost: bool,
    /// Time to wait if all servers are gone, or if none lets anything be played.
    pub patience: Duration,
    /// Keys and tokens for the handshakes.
    pub access: Access,
    /// Plays these episodes alone; others with the same file play the rest. `None` for all.
    pub shard: Option<Shard>,
    /// The servers play for this shard alone, so the run is closed there with it. Otherwise whoever plays the last episode
    /// closes it.
    pub is_alone: bool,
    /// The servers of the group draw the same hosted seeds, and each has episodes of its own (`sim-server --seed-group`): a run with hosted
    /// seeds is played on all of them. Without it one server plays it.
    pub shares_seeds: bool,
}

impl RunOptions {
    /// The default options for a run.
    pub fn new(file: RunFile) -> Self {
        Self {
            file,
            server: None,
            parallel: None,
            give_up_lost: false,
            patience: Duration::from_secs(60),
            access: Access::default(),
            shard: None,
            is_alone: false,
            shares_seeds: false,
        }
    }
}

/// Why a run could not be played. Whatever was played stays: the same call continues from there.
#[derive(Debug, Error)]
pub enum RunError {
    /// No server accepts the run.
    #[error(transparent)]
    Client(#[from] ClientError),
    /// The policy cannot be made, does not play the run's tasks, or refuses every session of the run.
    #[error(transparent)]
    Policy(#[from] PolicyError),
}

impl Client {
    /// Plays a run to its end, with several episodes at once, on one server or on all servers of a group. An episode
    /// whose server is lost moves to another one; a server that appears later joins. A later call with the same
    /// [`RunFile`] continues the run, whichever side died.
    ///
    /// `make_policy` is called for each attempt at an episode, in the thread that plays it, so that nothing leaks from
    /// one episode to the next; share large data, such as weights, through an `Arc`. The policy must be deterministic:
    /// an episode that was cut off is played again, and the server compares its rows. `progress` is called a few times
    /// a second. Setting `stop` soon ends the call, but not the run.
    ///
    /// ```no_run
    /// use std::sync::atomic::AtomicBool;
    ///
    /// use fiatlux_link::{CarrierArgs, Role};
    /// use fiatlux_policies::Zero;
    /// use fiatlux_client::{Client, RunFile, RunOptions};
    /// use fiatlux_proto::v3::RunSpec;
    ///
    /// let spec = RunSpec { policy: "mine".into(), seeds: vec![0, 1, 2, 3], ..RunSpec::default() };
    /// let options = RunOptions::new(RunFile::open("RUN.toml".as_ref(), &spec)?);
    /// let link = CarrierArgs { connect: vec!["tcp/192.168.1.7:7447".into()], ..CarrierArgs::default() }.open(Role::Client)?.carrier();
    /// let make_policy = || Ok(Box::new(Zero::default()) as _);
    /// let outcome = Client::evaluate(&link, &options, make_policy, &mut |_| (), &AtomicBool::new(false))?;
    /// for episode in &outcome.episodes {
    ///     println!("{} {:?}: {}", episode.task, episode.seed, episode.cause);
    /// }
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// [`RunError`]. Episodes that fail are not an error: the outcome lists them. Neither is a policy that refuses the
    /// sessions of some tasks: their episodes count as failures.
    pub fn evaluate(
        link: &Carrier,
        options: &RunOptions,
        make_policy: impl Fn() -> Result<Box<dyn Policy>, PolicyError> + Sync,
        progress: &mut dyn FnMut(&RunProgress),
        stop: &AtomicBool,
    ) -> Result<RunOutcome, RunError> {
        // Make a policy once, so that a failure shows before anything is registered.
        let tasks: Vec<Task> = options.file.spec.tasks.iter().filter_map(|task| task.parse().ok()).collect();
        let tasks = if tasks.is_empty() { &Task::SUBTASKS[..] } else { &tasks };
        check_tasks(make_policy()?.as_ref(), tasks)?;
        let group = Group::find(link, options)?;
        let links = Links::default();
        let (run, key, access) = (&options.file.run, &options.file.key, &options.access);
        let calls = Calls { link, run, key, access, links: &links };
        std::thread::scope(|scope| RunDriver::new(scope, calls, options, &make_policy, group, stop)?.play(progress))
    }
}

/// The servers that may take part, by name.
#[derive(Debug, Clone)]
struct Group {
    name: String,
    /// Servers whose names begin with the name and a hyphen belong to it too.
    is_open: bool,
}

impl Group {
    /// Waits until one of the requested servers answers.
    fn find(link: &Carrier, options: &RunOptions) -> Result<Self, ClientError> {
        let Some(name) = &options.server else {
            return Ok(Self { name: find_server(link, None)?, is_open: false });
        };
        // Each server would draw its own seeds.
        let group = Self { name: name.clone(), is_open: options.file.spec.hosted_seeds == 0 || options.shares_seeds };
        let start = Instant::now();
        loop {
            let found = live_servers(link)?;
            if found.iter().any(|server| group.has(server)) {
                return Ok(group);
            }
            if start.elapsed().as_secs_f64() >= DISCOVERY_S {
                let found = found.into_iter().collect();
                return Err(ClientError::NotThere { name: name.clone(), found, waited_s: DISCOVERY_S });
            }
            std::thread::sleep(Duration::from_millis(100));
        }
    }

    fn has(&self, server: &str) -> bool {
        let tail = server.strip_prefix(self.name.as_str());
        tail.is_some_and(|tail| tail.is_empty() || self.is_open && tail.starts_with('-'))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_group_has_the_servers_that_its_name_begins() {
        let group = Group { name: "lab".into(), is_open: true };
        assert!(["lab", "lab-1", "lab-west-2"].iter().all(|name| group.has(name)));
        assert!(["laboratory", "la", "my-lab", "lab_1"].iter().all(|name| !group.has(name)));
        assert!(!Group { is_open: false, ..group }.has("lab-1"));
    }
}
