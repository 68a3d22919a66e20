//! Records sessions into bags, an episode each.
//!
//! The carrier's callbacks put records into the queue of a worker thread, which alone holds its sessions' state
//! (`fiatlux_session::RecorderSession`) and writes their bags; a session stays with one worker. A row takes some 70 us
//! (poses, compression, file), so one worker keeps up with 14,000 rows/s: more than four cores simulate. There is a
//! worker for each four cores.
mod bags;
mod worker;

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::mpsc::{self, Sender};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use fiatlux_access::{RecorderKey, RowsKey};
use fiatlux_carrier::{Carrier, CarrierError, Declaration, Reach};
use fiatlux_proto::keys::{SessionKeys, any_truth_live, any_truth_row, is_name};
use fiatlux_proto::v3::{EpisodeHeader, EpisodeResult};
use fiatlux_robot::{Robot, RobotError};
use thiserror::Error;

use fiatlux_wire::Frames;
use worker::{Inlets, Worker, WorkerEvent};

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

/// Shared by all workers of a recorder.
struct RecorderState {
    out: PathBuf,
    name: String,
    naming: Naming,
    reach: Reach,
    /// Proves whose a session is, and unseals its records.
    key: RecorderKey,
    /// Records are sealed, because they come from other processes.
    is_sealed: bool,
    /// When the log last told of sessions of unknown servers.
    told_at: Mutex<Option<Instant>>,
    /// Frames of the robot with each kind of hands.
    frames: BTreeMap<&'static str, Frames>,
    on_bag: Box<dyn Fn(BagReport) + Send + Sync>,
    on_loss: OnLoss,
    inlets: Inlets,
}

impl RecorderState {
    /// The session that a token announces, by what its keys begin with. Anybody on the network can declare tokens: nothing
    /// is done for a session that no server with the recorder's key has announced.
    fn session_of(&self, token: &str) -> Option<Arc<str>> {
        let (keys, server, session) = SessionKeys::of(token)?;
        let (_, proof) = token.rsplit_once('/')?;
        if RowsKey::of_recorder(&self.key, server, session).is_ok_and(|rows| rows.is_token(proof)) {
            return Some(keys.root().into());
        }
        let mut told_at = self.told_at.lock().unwrap_or_else(PoisonError::into_inner);
        if told_at.is_none_or(|at| at.elapsed() >= TELLING_PERIOD) {
            *told_at = Some(Instant::now());
            let server = server.escape_debug();
            tracing::warn!(
                "ignoring sessions announced as server {server}'s: they come from a stranger, or the server's \
                 --recorder-key differs from this recorder's; give both the same file"
            );
        }
        None
    }
}

/// A running recorder. When dropped, it first writes everything that it has received, as [`Recorder::stop`] does.
pub struct Recorder {
    /// Subscriptions to the sessions' tokens and to their records.
    subscriptions: Vec<Declaration>,
    workers: Vec<(Sender<WorkerEvent>, JoinHandle<Vec<PathBuf>>)>,
}

impl Recorder {
    /// Follows all sessions, including those that are already open. Continues an unfinished bag if its session still
    /// exists.
    pub fn start(carrier: Carrier, options: RecorderOptions) -> Result<Self, RecorderError> {
        let RecorderOptions { out, server, name, naming, records, on_bag, on_loss } = options;
        let (reach, is_sealed, key) = match records {
            RecordsFrom::ThisProcess(key) => (Reach::ThisProcess, false, key),
            RecordsFrom::Servers(key) => (Reach::Everywhere, true, key),
        };
        if let Some(server) = server.as_ref().filter(|name| !is_name(name)) {
            return Err(RecorderError::Name(server.clone()));
        }
        let frames_of = |name| Ok((name, Frames::new(&Robot::by_name(name)?)));
        let frames = Robot::NAMES.into_iter().map(frames_of).collect::<Result<_, RobotError>>()?;
        let (inlets, told_at) = (Inlets::default(), Mutex::default());
        let shared = Arc::new(RecorderState {
            out,
            name,
            naming,
            reach,
            key,
            is_sealed,
            told_at,
            frames,
            on_bag,
            on_loss,
            inlets,
        });
        let cores = thread::available_parallelism().map_or(1, |cores| cores.get());
        let mut recorder = Self { subscriptions: Vec::new(), workers: Vec::new() };
        let workers = cores.div_ceil(CORES_PER_WORKER);
        for number in 0..workers {
            let (queue, inbox) = mpsc::channel();
            let (carrier, shared) = (carrier.clone(), Arc::clone(&shared));
            let worker = Worker { carrier, shared, inbox, queue: queue.clone(), start: Instant::now() };
            let thread = thread::Builder::new().name(format!("recorder-{number}")).spawn(move || worker.run());
            recorder.workers.push((queue, thread.map_err(RecorderError::Thread)?));
        }
        let queues: Vec<_> = recorder.workers.iter().map(|(queue, _)| queue.clone()).collect();
        let known = Arc::clone(&shared);
        let records = carrier.subscribe(&any_truth_row(server.as_deref()), shared.reach, move |message| {
            let Some((keys, ..)) = SessionKeys::of(&message.key) else { return };
            let inlets = known.inlets.read().unwrap_or_else(PoisonError::into_inner);
            if let Some(inlet) = inlets.get(keys.root()) {
                inlet.push(&message.payload);
            }
        })?;
        let tokens = carrier.watch_tokens(&any_truth_live(server.as_deref()), move |key, is_there| {
            let Some(key) = shared.session_of(key) else { return };
            // A session always goes to the same worker.
            let place = key.bytes().fold(0_usize, |sum, byte| sum.wrapping_mul(31).wrapping_add(byte.into()));
            let event = if is_there { WorkerEvent::Live(key) } else { WorkerEvent::Gone(key) };
            // The worker may be gone.
            let _ = queues[place % queues.len()].send(event);
        })?;
        recorder.subscriptions = vec![records, tokens];
        Ok(recorder)
    }

    /// Writes what has arrived, and ends. Returns the files of unfinished bags (`NAME.mcap.part`), sorted; a recorder
    /// that starts while their sessions are open continues them.
    pub fn stop(mut self) -> Vec<PathBuf> {
        self.end()
    }

    fn end(&mut self) -> Vec<PathBuf> {
        self.subscriptions.clear();
        for (queue, _) in &self.workers {
            let _ = queue.send(WorkerEvent::Stop);
        }
        let left = self.workers.drain(..).flat_map(|(_, thread)| thread.join().unwrap_or_default());
        let mut left: Vec<PathBuf> = left.collect();
        left.sort();
        left
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        self.end();
    }
}

#[cfg(test)]
mod tests;
