//! Where takes are played and recorded: on a server in this process, or on one elsewhere.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{self, Receiver};
use std::time::Duration;

use fiatlux_carrier::Carrier;
use fiatlux_client::{Access, Client, ClientError, describe_servers, find_server};
use fiatlux_proto::v3::{OpenRequest, SessionInfo};
use fiatlux_robot::Robot;
use fiatlux_rules::Task;
use fiatlux_server::{BagEnd, BagReport, LocalBags, LocalServer, Naming, ServerOptions};
use fiatlux_world::SceneConfig;
use thiserror::Error;

/// Name of the server in this process.
const SERVER: &str = "teleop";
/// Longest time for a bag to close.
const CLOSING_TIME: Duration = Duration::from_secs(15);
/// Operators take their time before they start.
const PATIENCE: Duration = Duration::from_secs(24 * 3600);
/// Suffix of the name of a bag that was put aside, so that nobody grades it.
const ASIDE: &str = "discarded";

/// Why no takes can be made.
#[derive(Debug, Error)]
pub enum TakeError {
    #[error("cannot use the folder {}; name another one with --out", path.display())]
    Folder { path: PathBuf, source: std::io::Error },
    #[error("cannot start the server")]
    Server(#[from] fiatlux_server::ServerError),
    #[error("cannot load the robot")]
    Robot(#[from] fiatlux_robot::RobotError),
    #[error("cannot show the room")]
    Scene(#[from] fiatlux_world::SceneError),
    #[error("cannot open a session")]
    Session(#[source] Box<ClientError>),
    #[error(
        "the robot or the rooms of server {server} are not those of this program, so the page cannot draw them; use programs of \
         one version, and start the server without --scene and --asset"
    )]
    OtherRoom { server: String },
}

/// Opens the sessions of takes, and keeps their bags.
pub(crate) trait Studio {
    /// # Errors
    /// The server is not there, or refuses.
    fn client(&self, request: OpenRequest) -> Result<Client, ClientError>;

    /// Index of the next episode in a room: a take is an episode of its own.
    fn next_episode(&self, task: Task, seed: u64) -> u64;

    /// The bag of a session that is closed. `None` where it did not come.
    fn bag(&mut self, info: &SessionInfo, episode: u64) -> Option<Bag>;

    /// Removes the bag of a take that was never started, where this can be done here.
    fn forget(&self, bag: &Bag);

    /// Puts a bag aside; false where this cannot be done here.
    ///
    /// # Errors
    /// [`TakeError::Folder`].
    fn discard(&self, bag: &Bag) -> Result<bool, TakeError>;

    /// True if the server can be lost and come back.
    fn comes_back(&self) -> bool;
}

/// The bag of a take.
#[derive(Debug, Clone)]
pub(crate) struct Bag {
    /// Where it is; for a server elsewhere, below its recorder's folder.
    pub path: PathBuf,
    /// Its end; `None` where only the server knows.
    pub end: Option<String>,
}

/// A server in this process, with its recorder.
pub(crate) struct OwnServer {
    server: LocalServer,
    reports: Receiver<BagReport>,
    out: PathBuf,
}

impl OwnServer {
    pub fn start(out: &Path) -> Result<Self, TakeError> {
        std::fs::create_dir_all(out).map_err(|source| TakeError::Folder { path: out.into(), source })?;
        let (sender, reports) = mpsc::channel();
        // Nobody waits for it if the program ends.
        let on_bag = Box::new(move |report| drop(sender.send(report)));
        let bags = LocalBags { out: out.into(), naming: Naming::Flat, thin: false, on_bag };
        let options =
            ServerOptions { name: SERVER.into(), workers: 1, action_timeout: PATIENCE, ..ServerOptions::default() };
        let server = LocalServer::start(fiatlux_carrier::memory(), options, Some(bags))?;
        Ok(Self { server, reports, out: out.into() })
    }

    pub fn close(self) {
        self.server.stop();
    }
}

impl Studio for OwnServer {
    fn client(&self, request: OpenRequest) -> Result<Client, ClientError> {
        Client::open(self.server.carrier(), Some(SERVER), request)
    }

    fn next_episode(&self, task: Task, seed: u64) -> u64 {
        next_episode(&self.out, task, seed)
    }

    fn bag(&mut self, _: &SessionInfo, _: u64) -> Option<Bag> {
        let BagReport { path, end, .. } = self.reports.recv_timeout(CLOSING_TIME).ok()?;
        let end = match end {
            BagEnd::Whole(result) => result.end.as_ref().map_or_else(String::new, |end| end.cause.clone()),
            BagEnd::Cut(reason) => reason,
        };
        Some(Bag { path, end: Some(end) })
    }

    fn forget(&self, bag: &Bag) {
        // What cannot be removed is a take of no steps.
        let _ = std::fs::remove_file(&bag.path);
    }

    fn discard(&self, bag: &Bag) -> Result<bool, TakeError> {
        let aside = bag.path.with_extension(format!("mcap.{ASIDE}"));
        std::fs::rename(&bag.path, &aside).map_err(|source| TakeError::Folder { path: aside, source })?;
        Ok(true)
    }

    fn comes_back(&self) -> bool {
        false
    }
}

/// Index of the next episode of a task in a room whose bags are in a folder.
fn next_episode(out: &Path, task: Task, seed: u64) -> u64 {
    let start = format!("{task}-s{seed}-e");
    let index = |name: &str| name.strip_prefix(&start)?.split('.').next()?.parse::<u64>().ok();
    let files = std::fs::read_dir(out).into_iter().flatten().flatten();
    let taken = files.filter_map(|file| index(&file.file_name().to_string_lossy()));
    taken.max().map_or(0, |last| last.saturating_add(1))
}

/// A server elsewhere, whose recorder keeps the bags.
pub struct ServerElsewhere {
    link: Carrier,
    name: String,
    access: Access,
    /// Index of the first take in each room, and of the next one where there was one.
    first: u64,
    next: BTreeMap<u64, u64>,
}

impl ServerElsewhere {
    /// Finds the server of that name, or the only one, and checks that its rooms are those that the page draws.
    ///
    /// # Errors
    /// [`TakeError::Session`]: it is not there. [`TakeError::OtherRoom`]: its robot or its rooms are others.
    pub fn find(link: Carrier, name: Option<&str>, access: Access, first: u64) -> Result<Self, TakeError> {
        let failed = |error| TakeError::Session(Box::new(error));
        let name = find_server(&link, name).map_err(failed)?;
        let servers = describe_servers(&link).map_err(failed)?;
        if let Some(server) = servers.iter().find(|server| server.server == name) {
            let own = [Robot::benchmark()?.digest().to_owned(), SceneConfig::default().digest()];
            if [&server.model_digest, &server.scene_digest] != own.each_ref() {
                return Err(TakeError::OtherRoom { server: name });
            }
        }
        Ok(Self { link, name, access, first, next: BTreeMap::new() })
    }
}

impl Studio for ServerElsewhere {
    fn client(&self, request: OpenRequest) -> Result<Client, ClientError> {
        Client::open_with(&self.link, Some(&self.name), request, &self.access)
    }

    fn next_episode(&self, _: Task, seed: u64) -> u64 {
        self.next.get(&seed).copied().unwrap_or(self.first)
    }

    fn bag(&mut self, info: &SessionInfo, episode: u64) -> Option<Bag> {
        self.next.insert(info.seed, episode.saturating_add(1));
        let task = info.task.as_ref().map_or("", |task| &task.task);
        let path = format!("{}/{}/{task}-s{}-e{episode}.mcap", info.server, info.session, info.seed);
        Some(Bag { path: path.into(), end: None })
    }

    fn forget(&self, _: &Bag) {}

    fn discard(&self, _: &Bag) -> Result<bool, TakeError> {
        Ok(false)
    }

    fn comes_back(&self) -> bool {
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn takes_of_a_room_are_numbered_those_put_aside_too() {
        let out = std::env::temp_dir().join(format!("fiatlux-teleop-names-{}", std::process::id()));
        std::fs::create_dir_all(&out).expect("a folder");
        assert_eq!(next_episode(&out, Task::S07, 1), 0);
        for name in ["S07-s1-e0.mcap", "S07-s1-e4.mcap.discarded", "S07-s10-e7.mcap", "S08-s1-e9.mcap", "notes.txt"] {
            std::fs::write(out.join(name), "").expect("a file");
        }
        assert_eq!(next_episode(&out, Task::S07, 1), 5);
        std::fs::remove_dir_all(out).expect("removed");
    }
}
