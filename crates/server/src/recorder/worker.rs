//! A thread that follows some of the sessions and writes their bags; the carrier's callbacks only put events into its queue.

use std::collections::BTreeMap;
use std::error::Error;
use std::path::PathBuf;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender};
use std::sync::{Arc, PoisonError, RwLock};
use std::time::{Duration, Instant};

use fiatlux_access::RowsKey;
use fiatlux_carrier::{Carrier, Message, Publisher, Quality, Question};
use fiatlux_proto::Bytes;
use fiatlux_proto::keys::SessionKeys;
use fiatlux_session::recorder::{Input, MAX_WAITING, Output};
use fiatlux_session::{Machine, RecorderSession};
use tracing::{debug, info, warn};

use super::RecorderState;
use super::bags::Bags;

/// Time between two checks of all sessions.
const TICK: Duration = Duration::from_millis(50);

/// Pause in which records gather, so that one waking serves several: to wake this thread costs a session more than to encode
/// a record.
const GATHERING: Duration = Duration::from_millis(2);

/// Longest wait for an answer.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(2);

/// Events for a worker; sessions are identified by what their keys begin with.
pub(super) enum WorkerEvent {
    /// The token of a session has appeared.
    Live(Arc<str>),
    /// The token of a session is gone.
    Gone(Arc<str>),
    /// A record, published or requested.
    StepRecord(Arc<str>, Bytes),
    /// The answer to a session's request is complete.
    Answered(Arc<str>),
    /// End, after what is in the queue.
    Stop,
}

/// Puts a session's records into the queue. Records over the limit are dropped and requested again.
#[derive(Clone)]
pub(super) struct Inlet {
    key: Arc<str>,
    queue: Sender<WorkerEvent>,
    queued: Arc<AtomicUsize>,
    /// Unseals the session's records; `None` if they come from this process.
    seal: Option<Arc<RowsKey>>,
}

impl Inlet {
    /// Takes a record in. What others send on the server's keys costs its own unsealing, and no place in the queue.
    pub fn push(&self, record: &Bytes) {
        let record = match &self.seal {
            None => record.clone(),
            Some(rows) => match rows.open(record) {
                Some(record) => record.into(),
                None => return debug!(key = %self.key, "dropping a record that is not the server's"),
            },
        };
        if self.queued.fetch_add(1, Ordering::Relaxed) >= MAX_WAITING {
            self.queued.fetch_sub(1, Ordering::Relaxed);
            return;
        }
        // The worker may be gone.
        let _ = self.queue.send(WorkerEvent::StepRecord(Arc::clone(&self.key), record));
    }
}

/// The inlets of all followed sessions, by what their keys begin with.
///
/// A single subscription serves them all: each further one costs more, and anybody can announce sessions.
pub(super) type Inlets = RwLock<BTreeMap<String, Inlet>>;

/// A session's place among the inlets.
struct Listed {
    shared: Arc<RecorderState>,
    key: String,
}

impl Listed {
    fn new(shared: &Arc<RecorderState>, key: String, inlet: Inlet) -> Self {
        shared.inlets.write().unwrap_or_else(PoisonError::into_inner).insert(key.clone(), inlet);
        Self { shared: Arc::clone(shared), key }
    }
}

impl Drop for Listed {
    fn drop(&mut self) {
        self.shared.inlets.write().unwrap_or_else(PoisonError::into_inner).remove(&self.key);
    }
}

/// Tells the worker that the carrier has dropped the callback of a request: no answer follows.
struct AnswerEnd(Inlet);

impl Drop for AnswerEnd {
    fn drop(&mut self) {
        let _ = self.0.queue.send(WorkerEvent::Answered(Arc::clone(&self.0.key)));
    }
}

struct Followed {
    keys: SessionKeys,
    inlet: Inlet,
    state: RecorderSession,
    bags: Bags,
    acks: Publisher,
    /// The token was withdrawn, not necessarily by the server.
    is_gone: bool,
    _listed: Listed,
}

/// State of a worker's thread.
pub(super) struct Worker {
    pub carrier: Carrier,
    pub shared: Arc<RecorderState>,
    pub inbox: Receiver<WorkerEvent>,
    pub queue: Sender<WorkerEvent>,
    pub start: Instant,
}

impl Worker {
    /// Follows sessions until it is told to stop; returns the files of unfinished bags.
    pub fn run(self) -> Vec<PathBuf> {
        let mut sessions: BTreeMap<Arc<str>, Followed> = BTreeMap::new();
        let mut tick_at = Duration::ZERO;
        let mut gathers = false;
        loop {
            let event = self.inbox.try_recv().or_else(|_| {
                if std::mem::take(&mut gathers) {
                    std::thread::sleep(GATHERING);
                }
                self.inbox.recv_timeout(TICK)
            });
            gathers |= matches!(event, Ok(WorkerEvent::StepRecord(..)));
            let now = self.start.elapsed();
            match event {
                Ok(WorkerEvent::Stop) | Err(RecvTimeoutError::Disconnected) => break,
                Ok(event) => self.handle(&mut sessions, event, now),
                Err(RecvTimeoutError::Timeout) => {}
            }
            if now >= tick_at {
                tick_at = now + TICK;
                let is_due = |session: &Followed| session.state.wake_at().is_some_and(|at| now >= at);
                sessions.retain(|_, session| !is_due(session) || self.advance(session, Input::Tick, now));
            }
        }
        sessions.into_values().filter_map(|session| session.bags.leave()).collect()
    }

    fn handle(&self, sessions: &mut BTreeMap<Arc<str>, Followed>, event: WorkerEvent, now: Duration) {
        let (key, input) = match event {
            WorkerEvent::Live(key) => {
                if !sessions.contains_key(&key)
                    && let Some(session) = self.follow(&key, now)
                {
                    sessions.insert(Arc::clone(&key), session);
                }
                if let Some(session) = sessions.get_mut(&key) {
                    session.is_gone = false;
                }
                (key, Input::ServerSeen)
            }
            WorkerEvent::Gone(key) => {
                if let Some(session) = sessions.get_mut(&key) {
                    session.is_gone = true;
                }
                (key, Input::ServerGone)
            }
            WorkerEvent::StepRecord(key, record) => {
                let Some(session) = sessions.get_mut(&key) else { return };
                session.inlet.queued.fetch_sub(1, Ordering::Relaxed);
                if session.is_gone {
                    // Whoever withdrew the token: the server is gone once it has been silent for that long.
                    session.state.handle(Input::ServerSeen, now);
                    session.state.handle(Input::ServerGone, now);
                }
                (key, Input::StepRecord(record))
            }
            WorkerEvent::Answered(key) => (key, Input::Answered),
            WorkerEvent::Stop => return,
        };
        if let Some(session) = sessions.get_mut(&key)
            && !self.advance(session, input, now)
        {
            sessions.remove(&key);
        }
    }

    fn follow(&self, key: &Arc<str>, now: Duration) -> Option<Followed> {
        let (keys, server, session) = SessionKeys::of(key)?;
        let mut bags = Bags::new(&self.shared, server, session);
        let name = &self.shared.name;
        let state = match bags.resume(server, session) {
            Some((header, next_step)) => {
                info!(%key, next_step, "continuing an unfinished bag");
                let mut state = RecorderSession::resume(name, header, next_step, now);
                state.handle(Input::OnDisk(bags.next_step_on_disk()), now);
                state
            }
            None if bags.are_begun(server, session) => RecorderSession::again(name, now),
            None => RecorderSession::new(name, now),
        };
        let rows = RowsKey::of_recorder(&self.shared.key, server, session);
        let rows = Arc::new(rows.map_err(|error| warn!(%key, %error, "cannot record a session")).ok()?);
        let seal = self.shared.is_sealed.then_some(rows);
        let acks = self.carrier.publisher(&keys.truth_ack(), "StepRecordAck", Quality::default(), self.shared.reach);
        let acks = acks.map_err(|error| warn!(%key, %error, "cannot acknowledge the records of a session")).ok()?;
        let inlet = Inlet { key: Arc::clone(key), queue: self.queue.clone(), queued: Arc::default(), seal };
        let listed = Listed::new(&self.shared, keys.root().into(), inlet.clone());
        debug!(%key, "recording a session");
        Some(Followed { keys, inlet, state, bags, acks, is_gone: false, _listed: listed })
    }

    /// Gives a session an input and carries out what it asks for; returns whether it continues.
    fn advance(&self, session: &mut Followed, input: Input, now: Duration) -> bool {
        session.state.handle(input, now);
        while let Some(output) = session.state.poll() {
            match output {
                Output::Request(request) => self.ask(session, request),
                Output::Ack(ack) => self.acknowledge(session, ack),
                Output::Lost(records) => (self.shared.on_loss)(&session.inlet.key, records),
                Output::Done => return false,
                Output::Write(write) => {
                    let written = match session.bags.write(write) {
                        Ok(()) => Input::OnDisk(session.bags.next_step_on_disk()),
                        Err(error) => Input::WriteFailed(root_cause(&error)),
                    };
                    session.state.handle(written, now);
                }
            }
        }
        true
    }

    fn ask(&self, session: &Followed, request: Bytes) {
        let end = AnswerEnd(session.inlet.clone());
        let proof = session.inlet.seal.as_ref().map(|rows| rows.prove("rows", &request).to_vec());
        let question = Question {
            key: session.keys.truth_rows(),
            message: "StepRecordRequest".into(),
            payload: request,
            attachment: proof.unwrap_or_default(),
            timeout: ANSWER_TIMEOUT,
            is_urgent: false,
            reach: self.shared.reach,
        };
        let take = move |reply| {
            if let Ok(Message { payload, .. }) = reply {
                end.0.push(&payload);
            }
        };
        if let Err(error) = self.carrier.ask(question, take) {
            warn!(key = %session.inlet.key, %error, "cannot ask for records");
        }
    }

    fn acknowledge(&self, session: &Followed, ack: Bytes) {
        let proof = session.inlet.seal.as_ref().map(|rows| rows.prove("ack", &ack).to_vec()).unwrap_or_default();
        if let Err(error) = session.acks.put(ack, proof) {
            warn!(key = %session.inlet.key, %error, "cannot acknowledge records");
        }
    }
}

/// Why a bag cannot be written, without its path: clients get to know it.
fn root_cause(error: &dyn Error) -> String {
    error.source().map_or_else(|| error.to_string(), root_cause)
}
