//! A server on a carrier.

use std::fs::File;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use fiatlux_access::{AccessError, Identity, RecorderKey, Tokens};
use fiatlux_carrier::{Carrier, CarrierError, Declaration};
use fiatlux_proto::keys::{self, ServerKeys};
use fiatlux_render::MeshError;
use fiatlux_robot::{Robot, RobotError};
use fiatlux_session::server::{Input, Timeouts};
use fiatlux_world::{SceneConfig, SceneError};
use thiserror::Error;

use super::actor::{Actor, Side};
use super::counts::{Counts, Tally};
use super::credentials::Credentials;
use super::info;
use super::links::Links;
use super::lock;
use super::networks::Networks;
use super::opens::Opens;
use super::pool::Job;
use super::runs::{RecordError, Runs, SharedSeeds};
use super::scenes::{Robots, Scenes};
use super::sessions::Sessions;
use super::state::{Queues, ServerState};
use crate::recorder::{Naming, Recorder, RecorderError, RecorderOptions, RecordsFrom};

/// Number of threads that answer: a reply to a client that does not read blocks its thread for seconds, until Zenoh
/// gives up.
const ANSWERING_THREADS: usize = 8;
/// Time for which a server that starts looks for another one of its name.
const LOOK_FOR_OTHERS: Duration = Duration::from_millis(500);

/// Recipients of the records of a server that does not record itself.
#[derive(Debug, Clone, Default)]
pub enum RecordsTo {
    /// Nobody: sessions cannot ask to be recorded. What uses the server's own carrier in this process may still follow.
    #[default]
    Nobody,
    /// A recorder on the server's own carrier in this process, which records do not leave. It knows the server's sessions
    /// by this key.
    ThisProcess(RecorderKey),
    /// Recorders that have this key, with which records are sealed.
    Recorders(RecorderKey),
}

/// Longer than any process lives; some 30 years.
const UNLIMITED: Duration = Duration::from_secs(1_000_000_000);

#[derive(Debug, Clone)]
pub struct ServerOptions {
    /// Name of the server, which is part of all its keys.
    pub name: String,
    /// Threads that step sessions, at least one. On a carrier that delivers in place, such as that of one process, clients step
    /// theirs themselves.
    pub workers: usize,
    /// Sessions that can be open at once.
    pub capacity: usize,
    /// Longest wait of a session for a client that is gone.
    pub grace: Duration,
    /// Longest wait for an action in real time.
    pub action_timeout: Duration,
    /// Longest wait for the action of a client that is there, in lockstep. On a carrier that delivers in place, such as that of one
    /// process, there is no limit.
    pub lockstep_timeout: Duration,
    /// A client repeats its action after this time without an observation.
    pub resend: Duration,
    /// Longest wait for a recorder that makes no progress.
    pub recorder_timeout: Duration,
    /// The numbers of the scene.
    pub scene: SceneConfig,
    /// Folder of the weights that sessions may name for the camera's features.
    pub weights: Option<PathBuf>,
    /// Folder of meshes that replace the built-in shapes of the robot; it is read once, at the start.
    pub meshes: Option<PathBuf>,
    /// Folder into which the server itself records all sessions, and in which it keeps its runs.
    pub record: Option<PathBuf>,
    /// Hosted seeds that servers with other folders share.
    pub shared_seeds: Option<SharedSeeds>,
    /// Keep its bags of whole episodes thin, as of [`RecorderOptions`].
    pub thin: bool,
    /// Recipients of records if the server does not record itself.
    pub records_to: RecordsTo,
    /// Identity by which clients recognise the server; drawn at the start if `None`.
    pub identity: Option<Arc<Identity>>,
    /// Who may open sessions, and how many; `None` if everybody may.
    pub tokens: Option<Tokens>,
}

impl Default for ServerOptions {
    fn default() -> Self {
        let Timeouts { claim: _, grace, action, lockstep, resend, recorder } = Timeouts::default();
        Self {
            name: "local".into(),
            workers: std::thread::available_parallelism().map_or(1, usize::from),
            capacity: 64,
            grace,
            action_timeout: action,
            lockstep_timeout: lockstep,
            resend,
            recorder_timeout: recorder,
            scene: SceneConfig::default(),
            weights: None,
            meshes: None,
            record: None,
            shared_seeds: None,
            thin: false,
            records_to: RecordsTo::default(),
            identity: None,
            tokens: None,
        }
    }
}

#[derive(Debug, Error)]
pub enum ServerError {
    #[error("'{0}' cannot be a server's name; use 1 to 64 letters, digits, - or _")]
    Name(String),
    #[error("another server is named '{0}'; stop it, or give this one another --name")]
    Taken(String),
    #[error("the group of shared seeds has no server '{0}'; name all its servers, in every one the same")]
    Group(String),
    #[error("{what} must be above 0")]
    Zero { what: &'static str },
    #[error("cannot load the robot")]
    Robot(#[from] RobotError),
    #[error("cannot use the scene config")]
    Scene(#[from] SceneError),
    #[error("cannot use the meshes of the robot")]
    Meshes(#[from] MeshError),
    #[error("cannot record")]
    Record(#[from] RecordError),
    #[error("cannot draw the server's keys")]
    Identity(#[from] AccessError),
    #[error("cannot start the recorder")]
    Recorder(#[from] RecorderError),
    #[error("{key} is refused: {source}; is the link still open?")]
    Carrier { key: String, source: CarrierError },
    #[error("cannot start a thread; use fewer --workers")]
    Thread(#[source] std::io::Error),
}

/// A server that runs until it is shut down or dropped.
pub struct Server {
    pub(super) shared: Arc<ServerState>,
    threads: Vec<JoinHandle<()>>,
    /// Everything that receives messages; dropped first.
    pub(super) endpoints: Vec<Declaration>,
    /// The server's token, and the one that clients of older versions look for.
    alive: Vec<Declaration>,
    /// The server's own recorder; dropped first, so that the rest learns what was recorded.
    recorder: Option<Recorder>,
    /// Keeps other servers of this name from recording into this folder.
    _lock: Option<File>,
}

impl Server {
    /// Starts a server on a carrier, which still belongs to the caller.
    ///
    /// # Errors
    /// [`ServerError`]: a name that is invalid or taken, an invalid scene config, a folder of meshes that cannot be
    /// used, or a refusal by the carrier or the system.
    pub fn start(carrier: Carrier, options: ServerOptions) -> Result<Self, ServerError> {
        if !keys::is_name(&options.name) {
            return Err(ServerError::Name(options.name));
        }
        for (what, number) in [("the number of workers", options.workers), ("the capacity", options.capacity)] {
            if number == 0 {
                return Err(ServerError::Zero { what });
            }
        }
        options.scene.check()?;
        let robots = Robots::load()?;
        let meshes = options.meshes.map(|folder| robots.meshes(&folder)).transpose()?.unwrap_or_default();
        let server_keys = ServerKeys::new(&options.name);
        if is_taken(&carrier, &server_keys.alive())? {
            return Err(ServerError::Taken(options.name));
        }
        if options.shared_seeds.as_ref().is_some_and(|shared| !shared.group.contains(&options.name)) {
            return Err(ServerError::Group(options.name));
        }
        let open = |folder| Runs::open(folder, &options.name, options.shared_seeds.clone());
        let recorded = options.record.as_deref().map(open).transpose()?;
        let (runs, lock) = recorded.unzip();
        let signer = options.identity.clone();
        let identity = options.identity.map_or_else(|| Identity::generate().map(Arc::new), Ok)?;
        tracing::info!(server = options.name, key = %identity.public(), "clients know this server by its key");
        let (token_key, recorder_key) = match options.records_to {
            _ if runs.is_some() => (Some(RecorderKey::generate()?), None),
            RecordsTo::Nobody => (None, None),
            RecordsTo::ThisProcess(key) => (Some(key), None),
            RecordsTo::Recorders(key) => (Some(key.clone()), Some(key)),
        };
        let lockstep_timeout = if carrier.delivers_in_place() { UNLIMITED } else { options.lockstep_timeout };
        let shared = Arc::new(ServerState {
            info: info::server(&options.name, options.capacity, robots.get(Robot::NAMES[0]), &options.scene),
            name: options.name,
            keys: server_keys,
            carrier,
            timeouts: Timeouts {
                grace: options.grace,
                action: options.action_timeout,
                lockstep: lockstep_timeout,
                resend: options.resend,
                recorder: options.recorder_timeout,
                ..Timeouts::default()
            },
            scenes: Scenes::new(options.scene, robots, meshes),
            networks: Networks::new(options.weights),
            queues: Queues::default(),
            runs,
            sessions: Sessions::new(options.capacity),
            credentials: Credentials { identity, signer, tokens: options.tokens, recorder_key, token_key },
            opens: Opens::default(),
            links: Links::default(),
            refused: AtomicU64::new(0),
            tally: Tally::default(),
            closing: AtomicBool::new(false),
            start: Instant::now(),
        });
        let (threads, endpoints, alive) = (Vec::new(), Vec::new(), Vec::new());
        let mut server = Self { shared, threads, endpoints, alive, recorder: None, _lock: lock };
        server.start_threads(options.workers).map_err(ServerError::Thread)?;
        if let Some(out) = options.record
            && let Some(key) = server.shared.credentials.token_key.clone()
        {
            server.record(out, options.thin, key)?;
        }
        server.listen()?;
        for key in [server.shared.keys.alive(), ServerKeys::legacy(&server.shared.name).alive()] {
            let token = server.shared.carrier.token(&key);
            server.alive.push(token.map_err(refused(key))?);
        }
        Ok(server)
    }

    /// Name under which clients find the server.
    pub fn name(&self) -> &str {
        &self.shared.name
    }

    pub fn open_sessions(&self) -> usize {
        self.shared.sessions.places.count()
    }

    /// The server's figures, whenever they are asked for; `None` once it is gone.
    pub fn counts(&self) -> impl Fn() -> Option<Counts> + Clone + Send + Sync + 'static {
        let shared = Arc::downgrade(&self.shared);
        move || shared.upgrade().map(|shared| shared.counts())
    }

    /// Number of messages since the start that did not come from a session's client, or came a second time.
    pub fn refused_messages(&self) -> u64 {
        self.shared.refused.load(Ordering::Relaxed)
    }

    /// Aborts all sessions, then waits for recorders, for at most `deadline`. Returns whether they have every record.
    pub fn shutdown(mut self, deadline: Duration) -> bool {
        self.shared.closing.store(true, Ordering::Relaxed);
        self.alive.clear();
        let until = Instant::now() + deadline;
        for actor in self.shared.sessions.all() {
            self.shared.send(&actor, Side::Server, Input::Terminate("the server shuts down"));
        }
        let settled = |actor: &Arc<Actor>| lock(&actor.session).is_settled();
        loop {
            let whole = self.shared.sessions.all().iter().all(settled);
            if whole || Instant::now() >= until {
                for actor in self.shared.sessions.all().iter().filter(|actor| !settled(actor)) {
                    let session = lock(&actor.session).info().session.clone();
                    tracing::error!(session, "a recorder has not taken all records of a session");
                }
                return whole;
            }
            std::thread::sleep(Duration::from_millis(10));
        }
    }

    fn start_threads(&mut self, workers: usize) -> std::io::Result<()> {
        for worker in 0..workers {
            let shared = Arc::clone(&self.shared);
            let thread = std::thread::Builder::new().name(format!("session-{worker}"));
            self.threads.push(thread.spawn(move || shared.work())?);
        }
        for number in 0..ANSWERING_THREADS {
            let shared = Arc::clone(&self.shared);
            let answers = std::thread::Builder::new().name(format!("answers-{number}"));
            self.threads.push(answers.spawn(move || shared.send_answers())?);
        }
        let shared = Arc::clone(&self.shared);
        let runs = std::thread::Builder::new().name("runs".into());
        self.threads.push(runs.spawn(move || shared.serve_runs())?);
        let shared = Arc::clone(&self.shared);
        let wake = move || {
            let wake = |actor: Arc<Actor>| {
                if actor.tick() {
                    shared.queues.jobs.push(Job::Run(actor));
                }
            };
            shared.queues.timer.run(|| shared.now(), wake);
        };
        self.threads.push(std::thread::Builder::new().name("timer".into()).spawn(wake)?);
        Ok(())
    }

    fn record(&mut self, out: PathBuf, thin: bool, key: RecorderKey) -> Result<(), ServerError> {
        let shared = Arc::clone(&self.shared);
        let options = RecorderOptions {
            out,
            server: Some(self.shared.name.clone()),
            name: self.shared.name.clone(),
            naming: Naming::ByRun,
            thin,
            records: RecordsFrom::ThisProcess(key),
            on_bag: Box::new(move |report| shared.take_bag(&report)),
            on_loss: Box::new(|session, records| {
                tracing::error!(session, records, "records of a session are in no bag");
            }),
        };
        self.recorder = Some(Recorder::start(self.shared.carrier.clone(), options)?);
        Ok(())
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.recorder = None;
        self.alive.clear();
        self.endpoints.clear();
        self.shared.queues.stop();
        for thread in self.threads.drain(..) {
            // Workers catch failures of sessions, so there is nothing left to report.
            let _ = thread.join();
        }
        for actor in self.shared.sessions.all() {
            drop(lock(&actor.wire).close());
        }
    }
}

/// True if another server holds the token.
fn is_taken(carrier: &Carrier, alive: &str) -> Result<bool, ServerError> {
    let tokens = carrier.tokens(alive, LOOK_FOR_OTHERS).map_err(refused(alive.into()))?;
    Ok(!tokens.is_empty())
}

pub(super) fn refused(key: String) -> impl FnOnce(CarrierError) -> ServerError {
    |source| ServerError::Carrier { key, source }
}

#[cfg(test)]
mod tests {
    use fiatlux_access::{Channel, Greeting, Label, Side as End, SignedReply};
    use fiatlux_carrier::Question;
    use fiatlux_proto::v3::{OpenReply, OpenRequest, ResetReply, open_reply, reset_reply};
    use fiatlux_proto::{Message, PROTOCOL};

    use super::*;
    use crate::server::host::tests::PANICS;

    /// A panic closes the session that caused it; the worker continues with the others.
    #[test]
    #[allow(clippy::unwrap_used)]
    fn a_panic_stays_in_its_session() {
        let carrier = fiatlux_carrier::memory();
        let options = ServerOptions { name: "panics".into(), workers: 1, capacity: 2, ..ServerOptions::default() };
        let server = Server::start(carrier.clone(), options).unwrap();
        let ask = |key, payload: Vec<u8>, attachment| {
            let (payload, timeout) = (payload.into(), Duration::from_secs(10));
            carrier.ask_all(Question { key, payload, attachment, timeout, ..Question::default() }).unwrap()
        };
        let mut channels = Vec::new();
        // Each client is a separate peer, because half of the places are reserved for peers that have none.
        let policy_peer = |policy: &str| if policy == PANICS { "a" } else { "b" };
        for policy in [PANICS, "sound"] {
            let (task, policy): (_, String) = ("S07".into(), policy.into());
            let greeting = Greeting::new(policy_peer(&policy), None).unwrap();
            let hello = Some(greeting.hello());
            let request = OpenRequest { protocol: Some(PROTOCOL), task, policy, hello, ..OpenRequest::default() };
            let request = request.encode_to_vec();
            let reply = ask(server.shared.keys.open(), request.clone(), Vec::new()).next().unwrap().unwrap();
            let reply = OpenReply::decode(reply.payload).unwrap();
            let Some(open_reply::Reply::Session(info)) = reply.reply else { panic!("{reply:?}") };
            let content = info.encode_to_vec();
            let said = SignedReply { request: &request, server: "panics", id: &info.session, content: &content };
            let verified = greeting.verify(said, &reply.welcome.unwrap(), None).unwrap();
            channels.push(Channel::new(&greeting.agree(&verified).unwrap(), End::Client).unwrap());
        }
        let mut channels = channels.into_iter();
        let mut seal = || channels.next().unwrap().seal(Label::Message("reset"), b"").to_vec();
        let [faulty, other] =
            <[_; 2]>::try_from(server.shared.sessions.all()).unwrap_or_else(|_| panic!("two sessions"));
        let key = server.shared.keys.session(&faulty.id).reset();
        let _unanswered = ask(key, Vec::new(), seal());
        let until = Instant::now() + Duration::from_secs(10);
        while server.shared.sessions.find(&faulty.id).is_some() && Instant::now() < until {
            std::thread::sleep(Duration::from_millis(1));
        }
        assert_eq!((server.shared.sessions.all().len(), server.open_sessions()), (1, 1));
        let key = server.shared.keys.session(&other.id).reset();
        let reply = ask(key, Vec::new(), seal()).next().unwrap().unwrap();
        let reply = ResetReply::decode(reply.payload).unwrap();
        assert!(matches!(reply.reply, Some(reset_reply::Reply::Observation(_))));
    }
}
