//! Records sessions into bags, an episode each.
//!
//! A worker thread alone holds its sessions' state (`fiatlux_session::RecorderSession`) and writes their bags; a session stays
//! with one worker. A row takes some 70 us (poses, compression, file), so one worker keeps up with 14,000 rows/s: more than
//! four cores simulate. There is a worker for each four cores.
//!
//! Nothing that a stranger may send reaches a worker. The carrier's callbacks put messages into lanes with little room
//! (`inlet`), from which another thread unseals them; tokens and requests have a thread (`greeter`), and so has the search
//! for a session's bags on disk (`shelf`), which begins with the session's first record.
mod bags;
mod greeter;
mod inlet;
mod locks;
mod poses;
mod shelf;
mod worker;

use std::path::PathBuf;
use std::sync::mpsc::{self, Sender};
use std::sync::{Arc, Mutex};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use fiatlux_access::RecorderKey;
use fiatlux_carrier::{Carrier, CarrierError, Declaration, Reach};
use fiatlux_proto::keys::{SessionKeys, any_live, any_truth_live, any_truth_row, is_name};
use fiatlux_proto::v3::{EpisodeHeader, EpisodeResult};
use fiatlux_robot::RobotError;
use thiserror::Error;

use bags::Names;
use greeter::{Greeter, Greeting, ToGreeter};
use inlet::{Inlet, Inlets, Lookup, Outlets, WorkerEvent, unseal_all};
use locks::lock;
pub(crate) use poses::Poses;
use shelf::{Shelf, prepare_all};
use worker::Worker;

const CORES_PER_WORKER: usize = 4;
/// Time between two lines in the log about sessions of unknown servers.
const TELLING_PERIOD: Duration = Duration::from_secs(60);

/// Names of bags below their folder. If one is taken, a number is added.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Naming {
    /// A folder for each session: `SERVER/SESSION/TASK-sSEED-eEPISODE.mcap`.
    #[default]
    BySession,
    /// All in one folder: `TASK-sSEED-eEPISODE.mcap`.
    Flat,
    /// Episodes of a run as `RUN/SERVER-TASK-sSEED-aATTEMPT.mcap`, others as by session.
    ByRun,
}

/// Whose records to write.
#[derive(Debug, Clone)]
pub enum RecordsFrom {
    /// Records from this process, on its own carrier: no other program can add a row. The server proves with this key which
    /// sessions are its own.
    ThisProcess(RecorderKey),
    /// Records from servers that have this key. What others send on the same keys is dropped.
    Servers(RecorderKey),
}

/// Called with the key of a session and the number of its records that are in no bag.
pub type OnLoss = Box<dyn Fn(&str, u64) + Send + Sync>;

/// Folder, servers and callbacks of a recorder.
pub struct RecorderOptions {
    /// Folder of the bags.
    pub out: PathBuf,
    /// Only this server's sessions; `None` for all.
    pub server: Option<String>,
    /// Name of the recorder, which servers log.
    pub name: String,
    pub naming: Naming,
    /// Keep bags of whole episodes thin: without the rows, which are simulated again when they are read.
    pub thin: bool,
    /// Whose records to write.
    pub records: RecordsFrom,
    /// Called with each bag that ends, by the thread that wrote it, so it must not block.
    pub on_bag: Box<dyn Fn(BagReport) + Send + Sync>,
    /// Called when records are lost, under the same conditions as `on_bag`.
    pub on_loss: OnLoss,
}

#[derive(Debug, Clone, PartialEq)]
pub enum BagEnd {
    Whole(Box<EpisodeResult>),
    /// The bag has only a part, for this reason.
    Cut(String),
}

#[derive(Debug, Clone, PartialEq)]
pub struct BagReport {
    /// The file: `NAME.mcap`, or `NAME.mcap.part` where it could not be finished.
    pub path: PathBuf,
    pub header: EpisodeHeader,
    /// Whole, or the reason why not.
    pub end: BagEnd,
}

#[derive(Debug, Error)]
pub enum RecorderError {
    #[error("'{0}' is not a server's name; use 1 to 64 letters, digits, - or _")]
    Name(String),
    #[error("cannot load the robot")]
    Robot(#[from] RobotError),
    #[error("cannot start a thread; free some memory")]
    Thread(#[source] std::io::Error),
    #[error("cannot watch for sessions; connect again")]
    Carrier(#[from] CarrierError),
}

/// Shared by all threads of a recorder.
struct RecorderState {
    out: PathBuf,
    name: String,
    naming: Naming,
    thin: bool,
    reach: Reach,
    /// Proves whose a session is, and unseals its records.
    key: RecorderKey,
    /// Records are sealed, because they come from other processes.
    is_sealed: bool,
    /// Origin of all times.
    start: Instant,
    /// When the log last told of sessions of unknown servers.
    told_at: Mutex<Option<Instant>>,
    /// Frames of the robot with each kind of hands.
    poses: Poses,
    on_bag: Box<dyn Fn(BagReport) + Send + Sync>,
    on_loss: OnLoss,
    inlets: Inlets,
    /// The bags in the folder, where all are in one.
    shelf: Mutex<Shelf>,
    names: Mutex<Names>,
}

impl RecorderState {
    /// Logs now and then that a token is not of a server with the recorder's key. Anybody on the network can declare tokens.
    fn tell_of_strangers(&self, token: &str) {
        let Some((_, server, _)) = SessionKeys::of(token) else { return };
        let mut told_at = lock(&self.told_at);
        if told_at.is_none_or(|at| at.elapsed() >= TELLING_PERIOD) {
            *told_at = Some(Instant::now());
            tracing::warn!(
                "ignoring sessions announced as server {server}'s: they come from a stranger, or the server's \
                 --recorder-key differs from this recorder's; give both the same file"
            );
        }
    }
}

/// A thread, and the call that ends it.
type Feeder = (Box<dyn Fn() + Send + Sync>, JoinHandle<()>);

/// A running recorder. When dropped, it first writes everything that it has received, as [`Recorder::stop`] does.
pub struct Recorder {
    /// Subscriptions to the sessions' tokens and to their records.
    subscriptions: Vec<Declaration>,
    /// Ends what feeds the workers, in this order.
    feeders: Vec<Feeder>,
    workers: Vec<(Sender<WorkerEvent>, JoinHandle<Vec<PathBuf>>)>,
}

impl Recorder {
    /// Follows all sessions, including those that are already open. Continues an unfinished bag if its session still
    /// exists.
    pub fn start(carrier: Carrier, options: RecorderOptions) -> Result<Self, RecorderError> {
        let RecorderOptions { out, server, name, naming, thin, records, on_bag, on_loss } = options;
        let (reach, is_sealed, key) = match records {
            RecordsFrom::ThisProcess(key) => (Reach::ThisProcess, false, key),
            RecordsFrom::Servers(key) => (Reach::Everywhere, true, key),
        };
        if let Some(server) = server.as_ref().filter(|name| !is_name(name)) {
            return Err(RecorderError::Name(server.clone()));
        }
        let poses = Poses::load()?;
        let shared = Arc::new(RecorderState {
            out,
            name,
            naming,
            thin,
            reach,
            key,
            is_sealed,
            start: Instant::now(),
            told_at: Mutex::default(),
            poses,
            on_bag,
            on_loss,
            inlets: Inlets::default(),
            shelf: Mutex::default(),
            names: Mutex::default(),
        });
        let (greetings, greeted) = mpsc::channel();
        let (lookups, looked_up) = mpsc::channel::<Option<Lookup>>();
        let mut recorder = Self { subscriptions: Vec::new(), feeders: Vec::new(), workers: Vec::new() };
        let mut outlets = Vec::new();
        let cores = thread::available_parallelism().map_or(1, |cores| cores.get());
        for number in 0..cores.div_ceil(CORES_PER_WORKER) {
            let (writer, inbox) = mpsc::channel();
            let worker = Worker { shared: Arc::clone(&shared), inbox, greeter: ToGreeter(greetings.clone()) };
            let thread = spawn(format!("recorder-{number}"), move || worker.run())?;
            recorder.workers.push((writer.clone(), thread));
            let unsealer = if is_sealed {
                let (unsealer, inbox) = mpsc::channel::<Option<Arc<Inlet>>>();
                let thread = spawn(format!("unsealer-{number}"), move || unseal_all(&inbox))?;
                let stop = unsealer.clone();
                recorder.feeders.push((Box::new(move || drop(stop.send(None))), thread));
                Some(unsealer)
            } else {
                None
            };
            outlets.push(Outlets { writer, lookups: lookups.clone(), unsealer });
        }
        let (known, searched) = (Arc::clone(&shared), carrier.clone());
        let thread = spawn("recorder-shelf".into(), move || prepare_all(&searched, &known, &looked_up))?;
        recorder.feeders.push((Box::new(move || drop(lookups.send(None))), thread));
        let greeter = Greeter { carrier: carrier.clone(), shared: Arc::clone(&shared), inbox: greeted, outlets };
        let thread = spawn("recorder-greeter".into(), move || greeter.run())?;
        let stop = greetings.clone();
        recorder.feeders.push((Box::new(move || drop(stop.send(Greeting::Stop))), thread));
        let records = carrier.subscribe(&any_truth_row(server.as_deref()), reach, move |message| {
            if let Some((keys, ..)) = SessionKeys::of(&message.key)
                && let Some(inlet) = shared.inlets.get(keys.root())
            {
                inlet.take_published(&message.payload);
            }
        })?;
        // The greeter may be gone.
        let to_greeter = greetings.clone();
        let tokens = carrier.watch_tokens(&any_truth_live(server.as_deref()), move |key, is_there| {
            let _ = greetings.send(Greeting::Token(key.into(), is_there));
        })?;
        recorder.subscriptions = vec![records, tokens];
        if is_sealed {
            let sessions = carrier.watch_tokens(&any_live(server.as_deref()), move |key, is_there| {
                if is_there {
                    let _ = to_greeter.send(Greeting::Open(key.into()));
                }
            })?;
            recorder.subscriptions.push(sessions);
        }
        Ok(recorder)
    }

    /// Writes what has arrived, and ends. Returns the files of unfinished bags (`NAME.mcap.part`), sorted; a recorder
    /// that starts while their sessions are open continues them.
    pub fn stop(mut self) -> Vec<PathBuf> {
        self.end()
    }

    fn end(&mut self) -> Vec<PathBuf> {
        self.subscriptions.clear();
        for (stop, thread) in self.feeders.drain(..) {
            stop();
            // One that panicked has said so.
            let _ = thread.join();
        }
        for (queue, _) in &self.workers {
            let _ = queue.send(WorkerEvent::Stop);
        }
        let left = self.workers.drain(..).flat_map(|(_, thread)| thread.join().unwrap_or_default());
        let mut left: Vec<PathBuf> = left.collect();
        left.sort();
        left
    }
}

fn spawn<T: Send + 'static>(
    name: String,
    body: impl FnOnce() -> T + Send + 'static,
) -> Result<JoinHandle<T>, RecorderError> {
    thread::Builder::new().name(name).spawn(body).map_err(RecorderError::Thread)
}

impl Drop for Recorder {
    fn drop(&mut self) {
        self.end();
    }
}

#[cfg(test)]
mod tests;
