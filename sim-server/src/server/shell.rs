//! A server on a Zenoh session.

use std::collections::BTreeMap;
use std::fs::File;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, RwLock};
use std::thread::JoinHandle;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use fiatlux_proto::keys::{self, ServerKeys};
use fiatlux_proto::v3::refusal::Code;
use fiatlux_proto::v3::{
    CloseReply, LookReply, OpenReply, Refusal, ResetReply, RunReply, look_reply, open_reply, reset_reply, run_reply,
};
use fiatlux_proto::{Bytes, Message, PROTOCOL, limits};
use fiatlux_render::{MeshError, RobotMeshes};
use fiatlux_robot::{HandKind, RobotError};
use fiatlux_session::server::{Input, Timeouts};
use fiatlux_world::{SceneConfig, SceneError};
use thiserror::Error;
use zenoh::bytes::ZBytes;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::Subscriber;
use zenoh::query::{Query, Queryable};
use zenoh::sample::{Locality, Sample, SampleKind};
use zenoh::{Session as Zenoh, Wait};

use super::actor::{Actor, Side};
use super::info;
use super::lock;
use super::networks::Networks;
use super::pool::{Job, Queue, Timer};
use super::runs::{RecordError, Runs};
use super::scenes::{Robots, Scenes};
use super::shared::{Shared, refuse, reply};
use crate::recorder::{Naming, Recorder, RecorderError, RecorderOptions};

/// Requests to open or describe that wait for a worker; more are refused.
const MAX_REQUESTS: usize = 256;
/// How long a start looks for another server of its name.
const LOOK_FOR_OTHERS: Duration = Duration::from_millis(500);

/// Choices of a server.
#[derive(Debug, Clone)]
pub struct ServerOptions {
    /// Name in all its keys.
    pub name: String,
    /// Worker threads.
    pub workers: usize,
    /// Sessions that can be open at once.
    pub capacity: usize,
    /// How long a session waits for a client that is gone.
    pub grace: Duration,
    /// How long a session waits for an action.
    pub action_timeout: Duration,
    /// After this long without an observation a client sends its action again.
    pub resend: Duration,
    /// How long a session waits for a recorder that makes no progress.
    pub recorder_timeout: Duration,
    /// All numbers of the scene.
    pub scene: SceneConfig,
    /// Folder of the weights that sessions may name for the camera's features.
    pub weights: Option<PathBuf>,
    /// Folder of meshes that the robot is drawn with in place of our own shapes; it is read once, at the start.
    pub meshes: Option<PathBuf>,
    /// Folder that all sessions are recorded into, by the server itself, and that keeps its runs.
    pub record: Option<PathBuf>,
}

impl Default for ServerOptions {
    fn default() -> Self {
        let Timeouts { grace, action, resend, recorder } = Timeouts::default();
        Self {
            name: "local".into(),
            workers: std::thread::available_parallelism().map_or(1, usize::from),
            capacity: 64,
            grace,
            action_timeout: action,
            resend,
            recorder_timeout: recorder,
            scene: SceneConfig::default(),
            weights: None,
            meshes: None,
            record: None,
        }
    }
}

/// Why a server does not start.
#[derive(Debug, Error)]
pub enum ServerError {
    /// The name cannot be part of a key.
    #[error("'{0}' cannot be a server's name; use 1 to 64 letters, digits, - or _")]
    Name(String),
    /// There is one of that name already.
    #[error("another server is named '{0}'; stop it, or give this one another --name")]
    Taken(String),
    /// A number that makes no server.
    #[error("{what} must be above 0")]
    Zero {
        /// What is 0.
        what: &'static str,
    },
    /// The robot's file.
    #[error("cannot load the robot")]
    Robot(#[from] RobotError),
    /// The scene config.
    #[error("cannot use the scene config")]
    Scene(#[from] SceneError),
    /// The folder of meshes.
    #[error("cannot use the meshes of the robot")]
    Meshes(#[from] MeshError),
    /// The folder of recordings.
    #[error("cannot record")]
    Record(#[from] RecordError),
    /// The recorder in the server.
    #[error("cannot start the recorder")]
    Recorder(#[from] RecorderError),
    /// Zenoh refused a key.
    #[error("Zenoh refuses {key}: {reason}; is its session still open?")]
    Zenoh {
        /// The key.
        key: String,
        /// What Zenoh says.
        reason: String,
    },
    /// The system gave no thread.
    #[error("cannot start a thread; use fewer --workers")]
    Thread(#[source] std::io::Error),
}

/// A server that runs until it is shut down or dropped.
pub struct Server {
    shared: Arc<Shared>,
    threads: Vec<JoinHandle<()>>,
    /// What receives messages; the first to go at the end.
    endpoints: Vec<Endpoint>,
    /// Its own, and the one that clients of older versions look for.
    alive: Vec<LivelinessToken>,
    /// The first to go at the end: what was recorded is known to the rest.
    recorder: Option<Recorder>,
    /// Nobody else records under this name into this folder while it is held.
    _lock: Option<File>,
}

#[expect(dead_code, reason = "held, not read: a declaration ends with its handle")]
enum Endpoint {
    Subscriber(Subscriber<()>),
    Queryable(Queryable<()>),
}

impl Server {
    /// Starts a server on a Zenoh session, which stays the caller's.
    ///
    /// # Errors
    /// [`ServerError`]: a name that does not fit or is taken, a scene config that makes no scene, a folder of meshes that
    /// cannot be used, or what Zenoh or the system refuse.
    pub fn start(zenoh: Zenoh, options: ServerOptions) -> Result<Self, ServerError> {
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
        let robot = robots.get(HandKind::default());
        let meshes = options.meshes.map(|folder| RobotMeshes::open(folder, robot)).transpose()?.map(Arc::new);
        let server_keys = ServerKeys::new(&options.name);
        if is_taken(&zenoh, &server_keys.alive())? {
            return Err(ServerError::Taken(options.name));
        }
        let recorded = options.record.as_ref().map(|folder| Runs::open(folder, &options.name)).transpose()?;
        let (runs, lock) = recorded.unzip();
        // Milliseconds since 1970: no earlier server of this name had it.
        let since_epoch = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let shared = Arc::new(Shared {
            info: info::server(&options.name, options.capacity, robot, &options.scene),
            name: options.name,
            keys: server_keys,
            zenoh,
            timeouts: Timeouts {
                grace: options.grace,
                action: options.action_timeout,
                resend: options.resend,
                recorder: options.recorder_timeout,
            },
            capacity: options.capacity,
            scenes: Scenes::new(options.scene, robots, meshes),
            networks: Networks::new(options.weights),
            queue: Queue::default(),
            answers: Queue::default(),
            timer: Timer::default(),
            runs,
            run_requests: Queue::default(),
            sessions: RwLock::new(BTreeMap::new()),
            open: AtomicUsize::new(0),
            closing: AtomicBool::new(false),
            id_prefix: format!("{:x}", since_epoch.as_millis()),
            next_id: AtomicU64::new(1),
            start: Instant::now(),
        });
        let (threads, endpoints, alive) = (Vec::new(), Vec::new(), Vec::new());
        let mut server = Self { shared, threads, endpoints, alive, recorder: None, _lock: lock };
        server.start_threads(options.workers).map_err(ServerError::Thread)?;
        if let Some(out) = options.record {
            server.record(out)?;
        }
        server.listen()?;
        for key in [server.shared.keys.alive(), ServerKeys::legacy(&server.shared.name).alive()] {
            let token = server.shared.zenoh.liveliness().declare_token(key.clone()).wait();
            server.alive.push(token.map_err(|error| refused(&key, error.as_ref()))?);
        }
        Ok(server)
    }

    /// Name of the server.
    pub fn name(&self) -> &str {
        &self.shared.name
    }

    /// Sessions that are open now.
    pub fn open_sessions(&self) -> usize {
        self.shared.open.load(Ordering::Relaxed)
    }

    /// Aborts what runs, then waits until recorders have everything, at most for `deadline`. Returns whether they do.
    pub fn shutdown(mut self, deadline: Duration) -> bool {
        self.shared.closing.store(true, Ordering::Relaxed);
        self.alive.clear();
        let until = Instant::now() + deadline;
        for actor in self.shared.all() {
            self.shared.send(&actor, Side::Server, Input::Terminate("the server shuts down"));
        }
        let settled = |actor: &Arc<Actor>| lock(&actor.session).is_settled();
        loop {
            let whole = self.shared.all().iter().all(settled);
            if whole || Instant::now() >= until {
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
        let shared = Arc::clone(&self.shared);
        let answers = std::thread::Builder::new().name("answers".into());
        self.threads.push(answers.spawn(move || shared.send_answers())?);
        let shared = Arc::clone(&self.shared);
        let runs = std::thread::Builder::new().name("runs".into());
        self.threads.push(runs.spawn(move || shared.serve_runs())?);
        let shared = Arc::clone(&self.shared);
        let wake = move || {
            let wake = |actor: Arc<Actor>| {
                if actor.tick() {
                    shared.queue.push(Job::Run(actor));
                }
            };
            shared.timer.run(|| shared.now(), wake);
        };
        self.threads.push(std::thread::Builder::new().name("timer".into()).spawn(wake)?);
        Ok(())
    }

    /// Starts the recorder in the server.
    fn record(&mut self, out: PathBuf) -> Result<(), ServerError> {
        let shared = Arc::clone(&self.shared);
        let options = RecorderOptions {
            out,
            server: Some(self.shared.name.clone()),
            name: self.shared.name.clone(),
            naming: Naming::ByRun,
            inside: true,
            on_bag: Box::new(move |report| shared.take_bag(&report)),
        };
        self.recorder = Some(Recorder::start(self.shared.zenoh.clone(), options)?);
        Ok(())
    }

    fn listen(&mut self) -> Result<(), ServerError> {
        let keys = &self.shared.keys;
        let any = keys.session("*");
        let (describe, open, run) = (keys.describe(), keys.open(), keys.run());
        // Only the server's own recorder says what is on disk, where it has one.
        let acks_from = if self.recorder.is_some() { Locality::SessionLocal } else { Locality::Any };
        let jobs =
            |shared: &Shared| shared.queue.fold(0, |count, job| count + usize::from(!matches!(job, Job::Run(_))));
        self.serve(describe, jobs, |shared, query| shared.queue.push(Job::Describe(query)))?;
        self.serve(open, jobs, |shared, query| shared.queue.push(Job::Open(query)))?;
        let requests = |shared: &Shared| shared.run_requests.fold(0, |count, _| count + 1);
        self.serve(run, requests, |shared, query| shared.run_requests.push(query))?;
        self.subscribe(any.action(), Side::Client, Locality::Any, Input::Action)?;
        self.subscribe(any.truth_ack(), Side::Recorder, acks_from, Input::Ack)?;
        self.serve_session(any.reset(), Side::Client, Input::Reset)?;
        self.serve_session(any.close(), Side::Client, Input::Close)?;
        self.serve_session(any.observation(), Side::Client, |_, query| Input::Observation(query))?;
        self.serve_session(any.look(), Side::Client, Input::Look)?;
        self.serve_records(any.truth_rows())?;
        self.watch_clients(any.client())?;
        let legacy = ServerKeys::legacy(&self.shared.name);
        self.refuse_legacy(legacy.open())?;
        self.refuse_legacy(legacy.describe())
    }

    /// Queries of clients of older versions, which would wait in vain otherwise.
    fn refuse_legacy(&mut self, key: String) -> Result<(), ServerError> {
        let message = format!("this server speaks protocol {PROTOCOL} alone; update the client to that version");
        self.declare_queryable(Locality::Any, key, move |query| reject(&query, Code::Version, "protocol", &message))
    }

    /// Messages to any session.
    fn subscribe(
        &mut self,
        key: String,
        side: Side,
        from: Locality,
        input: fn(Bytes) -> Input<Query>,
    ) -> Result<(), ServerError> {
        let shared = Arc::clone(&self.shared);
        let callback = move |sample: Sample| {
            let Some(actor) = session_of(&shared, sample.key_expr().as_str()) else { return };
            let bytes = sample.payload();
            match bytes.len() {
                length if length <= limits::MAX_CLIENT_MESSAGE => shared.send(&actor, side, input(own(bytes))),
                length if side == Side::Client => shared.send(&actor, side, Input::TooLarge(length)),
                length => tracing::debug!(length, "a recorder's message is too large"),
            }
        };
        let subscriber = self.shared.zenoh.declare_subscriber(key.clone()).allowed_origin(from);
        let subscriber = subscriber.callback(callback).wait();
        self.endpoints.push(Endpoint::Subscriber(subscriber.map_err(|error| refused(&key, error.as_ref()))?));
        Ok(())
    }

    /// Queries to any session.
    fn serve_session(
        &mut self,
        key: String,
        side: Side,
        input: fn(Bytes, Query) -> Input<Query>,
    ) -> Result<(), ServerError> {
        self.serve_session_to(Locality::Any, key, move |shared, actor, bytes, query| {
            shared.send(actor, side, input(bytes, query));
        })
    }

    /// Records for recorders. Those of a run go to the server's own alone: they tell the seed.
    fn serve_records(&mut self, key: String) -> Result<(), ServerError> {
        self.serve_session_to(Locality::SessionLocal, key.clone(), |shared, actor, bytes, query| {
            shared.send(actor, Side::Recorder, Input::StepRecords(bytes, query));
        })?;
        self.serve_session_to(Locality::Remote, key, |shared, actor, bytes, query| {
            if actor.attempt.is_some() {
                let message = "the records of a run stay on its server, which records them; read its bags";
                return reject(&query, Code::Closed, "", message);
            }
            shared.send(actor, Side::Recorder, Input::StepRecords(bytes, query));
        })
    }

    fn serve_session_to(
        &mut self,
        from: Locality,
        key: String,
        take: impl Fn(&Shared, &Arc<Actor>, Bytes, Query) + Send + Sync + 'static,
    ) -> Result<(), ServerError> {
        let shared = Arc::clone(&self.shared);
        let callback = move |query: Query| {
            let Some(actor) = session_of(&shared, query.key_expr().as_str()) else {
                return reject(&query, Code::Closed, "", "there is no such session; open one");
            };
            if query.payload().is_some_and(|bytes| bytes.len() > limits::MAX_CLIENT_MESSAGE) {
                return reject(&query, Code::Malformed, "", "the request is too large");
            }
            let bytes = query.payload().map(own).unwrap_or_default();
            take(&shared, &actor, bytes, query);
        };
        self.declare_queryable(from, key, callback)
    }

    /// Queries to the server: `waiting` counts those that are queued already, `push` queues one more.
    fn serve(
        &mut self,
        key: String,
        waiting: fn(&Shared) -> usize,
        push: fn(&Shared, Query),
    ) -> Result<(), ServerError> {
        let shared = Arc::clone(&self.shared);
        let callback = move |query: Query| {
            if query.payload().is_some_and(|bytes| bytes.len() > limits::MAX_CLIENT_MESSAGE) {
                reject(&query, Code::Malformed, "", "the request is too large");
            } else if waiting(&shared) >= MAX_REQUESTS {
                reject(&query, Code::Busy, "", "too many requests wait; try again later");
            } else {
                push(&shared, query);
            }
        };
        self.declare_queryable(Locality::Any, key, callback)
    }

    fn declare_queryable(
        &mut self,
        from: Locality,
        key: String,
        callback: impl Fn(Query) + Send + Sync + 'static,
    ) -> Result<(), ServerError> {
        let queryable = self.shared.zenoh.declare_queryable(key.clone()).allowed_origin(from);
        let queryable = queryable.callback(callback).wait();
        self.endpoints.push(Endpoint::Queryable(queryable.map_err(|error| refused(&key, error.as_ref()))?));
        Ok(())
    }

    /// Liveliness tokens of clients.
    fn watch_clients(&mut self, key: String) -> Result<(), ServerError> {
        let shared = Arc::clone(&self.shared);
        let callback = move |sample: Sample| {
            if let Some(actor) = session_of(&shared, sample.key_expr().as_str()) {
                let seen = sample.kind() == SampleKind::Put;
                shared.send(&actor, Side::Server, if seen { Input::ClientSeen } else { Input::ClientGone });
            }
        };
        let subscriber = self.shared.zenoh.liveliness().declare_subscriber(key.clone()).history(true);
        let subscriber = subscriber.callback(callback).wait();
        self.endpoints.push(Endpoint::Subscriber(subscriber.map_err(|error| refused(&key, error.as_ref()))?));
        Ok(())
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.recorder = None;
        self.alive.clear();
        self.endpoints.clear();
        self.shared.queue.stop();
        self.shared.answers.stop();
        self.shared.run_requests.stop();
        self.shared.timer.stop();
        for thread in self.threads.drain(..) {
            // A worker catches what goes wrong in a session; nothing is left to say here.
            let _ = thread.join();
        }
        for actor in self.shared.all() {
            drop(lock(&actor.wire).take());
        }
    }
}

/// Whether some server holds the token.
fn is_taken(zenoh: &Zenoh, alive: &str) -> Result<bool, ServerError> {
    let tokens = zenoh.liveliness().get(alive).timeout(LOOK_FOR_OTHERS).wait();
    let tokens = tokens.map_err(|error| refused(alive, error.as_ref()))?;
    Ok(tokens.into_iter().any(|token| token.result().is_ok()))
}

fn refused(key: &str, error: &(dyn std::error::Error + Send + Sync)) -> ServerError {
    ServerError::Zenoh { key: key.into(), reason: error.to_string() }
}

/// A message of Zenoh's, as the session takes it.
fn own(bytes: &ZBytes) -> Bytes {
    bytes.to_bytes().into_owned().into()
}

fn session_of(shared: &Shared, key: &str) -> Option<Arc<Actor>> {
    let (_, _, id) = keys::SessionKeys::of(key)?;
    shared.find(id)
}

/// A refusal that needs no session, in the form that the query's key asks for.
fn reject(query: &Query, code: Code, field: &str, message: &str) {
    let refused = Refusal::new(code, field, message);
    let key = query.key_expr().as_str();
    match key.rsplit('/').next() {
        Some("open") => {
            let answer = OpenReply { reply: Some(open_reply::Reply::Refusal(refused)) };
            reply(query, "OpenReply", answer.encode_to_vec().into());
        }
        Some("run") => {
            let answer = RunReply { reply: Some(run_reply::Reply::Refusal(refused)) };
            reply(query, "RunReply", answer.encode_to_vec().into());
        }
        Some("reset") => {
            let answer = ResetReply { reply: Some(reset_reply::Reply::Refusal(refused)) };
            reply(query, "ResetReply", answer.encode_to_vec().into());
        }
        Some("look") => {
            let answer = LookReply { reply: Some(look_reply::Reply::Refusal(refused)) };
            reply(query, "LookReply", answer.encode_to_vec().into());
        }
        Some("close") => {
            let answer = CloseReply { refusal: Some(refused) };
            reply(query, "CloseReply", answer.encode_to_vec().into());
        }
        _ => refuse(query, refused.encode_to_vec().into()),
    }
}

#[cfg(test)]
mod tests {
    use fiatlux_proto::PROTOCOL;
    use fiatlux_proto::v3::OpenRequest;

    use super::*;
    use crate::server::host::tests::PANICS;

    /// A fault of ours closes the session that met it; the worker goes on with the others.
    #[test]
    #[allow(clippy::unwrap_used)]
    fn a_panic_stays_in_its_session() {
        let zenoh = fiatlux_link::embedded().unwrap();
        let options = ServerOptions { name: "panics".into(), workers: 1, capacity: 2, ..ServerOptions::default() };
        let server = Server::start(zenoh.clone(), options).unwrap();
        for policy in [PANICS, "sound"] {
            let (task, policy) = ("S07".into(), policy.into());
            let request = OpenRequest { protocol: Some(PROTOCOL), task, policy, ..OpenRequest::default() };
            let replies = zenoh.get(server.shared.keys.open()).payload(request.encode_to_vec()).wait().unwrap();
            assert!(replies.recv().unwrap().result().is_ok());
        }
        let [faulty, other] = <[_; 2]>::try_from(server.shared.all()).unwrap_or_else(|_| panic!("two sessions"));
        let key = server.shared.keys.session(&faulty.id).reset();
        let _unanswered = zenoh.get(key).wait().unwrap();
        let until = Instant::now() + Duration::from_secs(10);
        while server.shared.find(&faulty.id).is_some() && Instant::now() < until {
            std::thread::sleep(Duration::from_millis(1));
        }
        assert_eq!((server.shared.all().len(), server.open_sessions()), (1, 1));
        let key = server.shared.keys.session(&other.id).reset();
        let reply = zenoh.get(key).wait().unwrap().recv().unwrap();
        let reply = ResetReply::decode(&*reply.result().unwrap().payload().to_bytes()).unwrap();
        assert!(matches!(reply.reply, Some(reset_reply::Reply::Observation(_))));
    }
}
