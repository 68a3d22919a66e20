//! A thread that follows some of the sessions: Zenoh's callbacks only put into its queue, it writes bags.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender};
use std::time::{Duration, Instant};

use fiatlux_proto::keys::SessionKeys;
use fiatlux_proto::{Bytes, encoding};
use fiatlux_session::recorder::{Input, MAX_WAITING, Output};
use fiatlux_session::{Machine, RecorderSession};
use tracing::{debug, info, warn};
use zenoh::bytes::{Encoding, ZBytes};
use zenoh::pubsub::Subscriber;
use zenoh::query::{ConsolidationMode, Reply};
use zenoh::sample::Sample;
use zenoh::{Session as Zenoh, Wait};

use super::Shared;
use super::bags::Bags;

/// Between two looks at all sessions.
const TICK: Duration = Duration::from_millis(50);

/// An answer takes no longer.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(2);

/// What a worker is told; sessions go by the key of their token.
pub(super) enum WorkerEvent {
    /// The token of a session is there.
    Live(Arc<str>),
    /// It is gone.
    Gone(Arc<str>),
    /// A record, sent or asked for.
    StepRecord(Arc<str>, ZBytes),
    /// The answer to a session's request is complete.
    Answered(Arc<str>),
    /// End, after what is in the queue.
    Stop,
}

/// Puts a session's records into the queue. Those over the limit are dropped, and asked for again.
#[derive(Clone)]
struct Inlet {
    key: Arc<str>,
    queue: Sender<WorkerEvent>,
    queued: Arc<AtomicUsize>,
}

impl Inlet {
    fn push(&self, sample: &Sample) {
        if self.queued.fetch_add(1, Ordering::Relaxed) >= MAX_WAITING {
            self.queued.fetch_sub(1, Ordering::Relaxed);
            return;
        }
        // The worker may be gone.
        let _ = self.queue.send(WorkerEvent::StepRecord(Arc::clone(&self.key), sample.payload().clone()));
    }
}

/// Tells the worker that Zenoh has dropped the callback of a request: no answer follows.
struct AnswerEnd(Inlet);

impl Drop for AnswerEnd {
    fn drop(&mut self) {
        let _ = self.0.queue.send(WorkerEvent::Answered(Arc::clone(&self.0.key)));
    }
}

/// A session that is followed.
struct Followed {
    keys: SessionKeys,
    inlet: Inlet,
    state: RecorderSession,
    bags: Bags,
    _records: Subscriber<()>,
}

/// A worker's thread.
pub(super) struct Worker {
    pub zenoh: Zenoh,
    pub shared: Arc<Shared>,
    pub inbox: Receiver<WorkerEvent>,
    pub queue: Sender<WorkerEvent>,
    pub start: Instant,
}

impl Worker {
    /// Follows sessions until it is told to stop; returns the files of unfinished bags.
    pub fn run(self) -> Vec<PathBuf> {
        let mut sessions: BTreeMap<Arc<str>, Followed> = BTreeMap::new();
        let mut tick_at = Duration::ZERO;
        loop {
            let event = self.inbox.recv_timeout(TICK);
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
                (key, Input::ServerSeen)
            }
            WorkerEvent::Gone(key) => (key, Input::ServerGone),
            WorkerEvent::StepRecord(key, bytes) => {
                if let Some(session) = sessions.get(&key) {
                    session.inlet.queued.fetch_sub(1, Ordering::Relaxed);
                }
                (key, Input::StepRecord(bytes.to_bytes().into_owned().into()))
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
                info!(%key, next_step, "an unfinished bag is taken up");
                RecorderSession::resume(name, header, next_step, now)
            }
            None => RecorderSession::new(name, now),
        };
        let inlet = Inlet { key: Arc::clone(key), queue: self.queue.clone(), queued: Arc::default() };
        let heard = inlet.clone();
        let records = self.zenoh.declare_subscriber(keys.truth_row()).allowed_origin(self.shared.locality);
        let records = records.callback(move |sample| heard.push(&sample)).wait();
        let records = records.map_err(|error| warn!(%key, %error, "a session is not recorded")).ok()?;
        debug!(%key, "a session is recorded");
        Some(Followed { keys, inlet, state, bags, _records: records })
    }

    /// Gives a session an input and does what it wants done; returns whether it goes on.
    fn advance(&self, session: &mut Followed, input: Input, now: Duration) -> bool {
        session.state.handle(input, now);
        while let Some(output) = session.state.poll() {
            match output {
                Output::Request(request) => self.ask(session, request),
                Output::Ack(ack) => self.acknowledge(session, ack),
                Output::Done => return false,
                Output::Write(write) => {
                    let written = session.bags.write(write);
                    let next_step = session.bags.next_step_on_disk();
                    session.state.handle(if written { Input::OnDisk(next_step) } else { Input::WriteFailed }, now);
                }
            }
        }
        true
    }

    fn ask(&self, session: &Followed, request: Bytes) {
        let end = AnswerEnd(session.inlet.clone());
        let take = move |reply: Reply| {
            if let Ok(sample) = reply.result() {
                end.0.push(sample);
            }
        };
        let asked = self.zenoh.get(session.keys.truth_rows()).allowed_destination(self.shared.locality);
        let asked = asked.payload(request).encoding(Encoding::from(encoding("StepRecordRequest")));
        // All replies have one key, and each counts.
        let asked = asked.consolidation(ConsolidationMode::None).timeout(ANSWER_TIMEOUT);
        if let Err(error) = asked.callback(take).wait() {
            warn!(key = %session.inlet.key, %error, "cannot ask for records");
        }
    }

    fn acknowledge(&self, session: &Followed, ack: Bytes) {
        let put = self.zenoh.put(session.keys.truth_ack(), ack).allowed_destination(self.shared.locality);
        if let Err(error) = put.encoding(Encoding::from(encoding("StepRecordAck"))).wait() {
            warn!(key = %session.inlet.key, %error, "cannot acknowledge records");
        }
    }
}
