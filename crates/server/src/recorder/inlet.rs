//! The way of a session's records from the carrier to the thread that writes them.
//!
//! Anybody can publish on a session's keys and answer on them, so a carrier's callback only puts what arrives into a lane of
//! the session's inlet, which has room for a few messages. Threads of their own unseal what is in the lanes, in turns, so
//! many messages of each session at a time. The thread that writes gets nothing but records that the server has
//! sealed, each once.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender};
use std::sync::{Arc, Mutex, PoisonError, RwLock};
use std::time::{Duration, Instant};

use fiatlux_access::{RowsKey, sealed_seq};
use fiatlux_carrier::Publisher;
use fiatlux_proto::Bytes;
use fiatlux_session::RecorderSession;
use fiatlux_session::recorder::MAX_WAITING;

use super::RecorderState;
use super::bags::Bags;
use super::locks::lock;

/// Messages that wait to be unsealed: published ones, and answers to the recorder's requests.
const MAX_PUBLISHED: usize = 256;
const MAX_REPLIED: usize = 512;

/// Their bytes; a lane takes a larger message alone.
const MAX_PUBLISHED_BYTES: usize = 8 << 20;
const MAX_REPLIED_BYTES: usize = 64 << 20;

/// Records of one session that are unsealed before others have their turn.
const TURN: usize = 64;
const TURN_BYTES: usize = 1 << 20;

/// Pause of a session after a turn with more messages of strangers than of its server: that many of their messages are
/// unsealed a second, at most.
const PAUSE: Duration = Duration::from_millis(2);

/// Numbers of records that are remembered, so that copies are not unsealed again.
const MAX_SEEN: usize = 2 * MAX_WAITING;

/// Events for a worker; sessions are identified by what their keys begin with.
pub(super) enum WorkerEvent {
    /// Write the bags of this session.
    Follow(Box<Followed>),
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

/// A session's place among the inlets.
pub(super) struct Listed {
    pub shared: Arc<RecorderState>,
    pub inlet: Arc<Inlet>,
}

impl Drop for Listed {
    fn drop(&mut self) {
        self.shared.inlets.remove(&self.inlet);
    }
}

/// A session whose bags are written.
pub(super) struct Followed {
    pub inlet: Arc<Inlet>,
    pub state: RecorderSession,
    pub bags: Bags,
    pub acks: Publisher,
    pub _listed: Listed,
}

/// A request to look for the bags of a session.
pub(super) struct Lookup(pub Arc<Inlet>);

/// Where a session is on its way to a bag.
enum Stage {
    /// Its server has announced it, and no record has come.
    Announced,
    /// A record has come. Its bags on disk are looked for; these records wait until they are found.
    LookedFor(Vec<Bytes>),
    /// A worker has it.
    Followed,
}

/// Arrivals for one session.
pub(super) struct Inlet {
    /// Beginning of the session's keys.
    pub key: Arc<str>,
    /// Unseals its records and proves requests; `None` if records come from this process.
    pub seal: Option<RowsKey>,
    /// The token was withdrawn, not necessarily by the server.
    pub is_gone: AtomicBool,
    /// Number of the server's records that have come.
    heard: AtomicU64,
    writer: Sender<WorkerEvent>,
    lookups: Sender<Option<Lookup>>,
    unsealer: Option<Sender<Option<Arc<Inlet>>>>,
    /// Number of records in the writer's queue.
    queued: AtomicUsize,
    lanes: Mutex<Lanes>,
    sieve: Mutex<Sieve>,
    stage: Mutex<Stage>,
}

#[derive(Default)]
struct Lanes {
    published: Lane,
    replied: Lane,
    /// It is in the unsealer's queue, or the unsealer has it.
    is_scheduled: bool,
}

#[derive(Default)]
struct Lane {
    /// `None` is the end of an answer.
    waiting: VecDeque<Option<Bytes>>,
    bytes: usize,
}

impl Lane {
    /// Takes a message in, or drops it: it is requested again.
    fn push(&mut self, message: &Bytes, most: usize, most_bytes: usize) {
        if self.waiting.len() < most && (self.bytes == 0 || self.bytes + message.len() <= most_bytes) {
            self.bytes += message.len();
            self.waiting.push_back(Some(message.clone()));
        }
    }

    fn pop(&mut self) -> Option<Option<Bytes>> {
        let message = self.waiting.pop_front()?;
        self.bytes -= message.as_ref().map_or(0, Bytes::len);
        Some(message)
    }
}

/// Numbers of the records that have come: anybody can send a copy of a sealed record.
#[derive(Default)]
struct Sieve {
    /// Every record before this one counts as seen.
    below: u64,
    seen: BTreeSet<u64>,
}

impl Sieve {
    fn is_new(&self, seq: u64) -> bool {
        seq >= self.below && !self.seen.contains(&seq)
    }

    fn note(&mut self, seq: u64) {
        self.seen.insert(seq);
        while self.seen.len() > MAX_SEEN {
            self.below = self.seen.pop_first().map_or(self.below, |first| self.below.max(first.saturating_add(1)));
        }
    }

    /// Takes these records once more: they are requested.
    fn expect(&mut self, from: u64, count: u64) {
        self.below = self.below.min(from);
        let after = self.seen.split_off(&from.saturating_add(count));
        self.seen.split_off(&from);
        self.seen.extend(after);
    }
}

/// Where an inlet's messages go.
#[derive(Clone)]
pub(super) struct Outlets {
    pub writer: Sender<WorkerEvent>,
    pub lookups: Sender<Option<Lookup>>,
    pub unsealer: Option<Sender<Option<Arc<Inlet>>>>,
}

impl Inlet {
    pub fn new(key: Arc<str>, seal: Option<RowsKey>, outlets: Outlets) -> Self {
        let Outlets { writer, lookups, unsealer } = outlets;
        Self {
            key,
            seal,
            is_gone: AtomicBool::new(false),
            heard: AtomicU64::new(0),
            writer,
            lookups,
            unsealer,
            queued: AtomicUsize::new(0),
            lanes: Mutex::default(),
            sieve: Mutex::default(),
            stage: Mutex::new(Stage::Announced),
        }
    }

    /// Takes in what was published on the session's key.
    pub fn take_published(self: &Arc<Self>, message: &Bytes) {
        self.take(message, |lanes| lanes.published.push(message, MAX_PUBLISHED, MAX_PUBLISHED_BYTES));
    }

    /// Takes in an answer to a request.
    pub fn take_reply(self: &Arc<Self>, message: &Bytes) {
        self.take(message, |lanes| lanes.replied.push(message, MAX_REPLIED, MAX_REPLIED_BYTES));
    }

    fn take(self: &Arc<Self>, message: &Bytes, push: impl FnOnce(&mut Lanes)) {
        if self.seal.is_none() {
            return self.deliver(message.clone());
        }
        let mut lanes = lock(&self.lanes);
        push(&mut lanes);
        self.schedule(&mut lanes);
    }

    /// Tells the worker that no answer follows, after the answers that wait.
    pub fn end_answer(self: &Arc<Self>) {
        if self.seal.is_none() {
            let _ = self.writer.send(WorkerEvent::Answered(Arc::clone(&self.key)));
            return;
        }
        let mut lanes = lock(&self.lanes);
        lanes.replied.waiting.push_back(None);
        self.schedule(&mut lanes);
    }

    fn schedule(self: &Arc<Self>, lanes: &mut Lanes) {
        if let Some(unsealer) = &self.unsealer
            && !std::mem::replace(&mut lanes.is_scheduled, true)
        {
            // The thread may be gone.
            let _ = unsealer.send(Some(Arc::clone(self)));
        }
    }

    /// Unseals a turn's messages. Returns whether more wait, and whether the session has to pause.
    fn unseal(self: &Arc<Self>) -> (bool, bool) {
        let (mut good, mut bad, mut bytes) = (0, 0, 0);
        while good + bad < TURN && bytes < TURN_BYTES {
            let mut lanes = lock(&self.lanes);
            // In turns: a flood of one of the two does not keep the other out.
            let Lanes { published, replied, .. } = &mut *lanes;
            let [one, two] = if (good + bad) % 2 == 0 { [replied, published] } else { [published, replied] };
            let Some(message) = one.pop().or_else(|| two.pop()) else {
                lanes.is_scheduled = false;
                return (false, false);
            };
            drop(lanes);
            let Some(message) = message else {
                let _ = self.writer.send(WorkerEvent::Answered(Arc::clone(&self.key)));
                continue;
            };
            bytes += message.len();
            if self.unseal_one(&message) { good += 1 } else { bad += 1 }
        }
        (true, bad > good)
    }

    /// True if it is a record of the server that has not come before.
    fn unseal_one(self: &Arc<Self>, message: &Bytes) -> bool {
        let (Some(rows), Some(seq)) = (&self.seal, sealed_seq(message)) else { return false };
        if !lock(&self.sieve).is_new(seq) {
            return false;
        }
        let Some(record) = rows.open(message) else { return false };
        lock(&self.sieve).note(seq);
        self.deliver(record.into());
        true
    }

    /// Passes a record of the server on.
    fn deliver(self: &Arc<Self>, record: Bytes) {
        self.heard.fetch_add(1, Ordering::Relaxed);
        let mut stage = lock(&self.stage);
        match &mut *stage {
            Stage::Announced => {
                *stage = Stage::LookedFor(vec![record]);
                // The thread may be gone.
                let _ = self.lookups.send(Some(Lookup(Arc::clone(self))));
            }
            Stage::LookedFor(waiting) if waiting.len() >= MAX_WAITING => {}
            Stage::LookedFor(waiting) => waiting.push(record),
            Stage::Followed => self.enqueue(record),
        }
    }

    /// Puts a record into the worker's queue. Records over the limit are dropped and requested again.
    fn enqueue(&self, record: Bytes) {
        if self.queued.fetch_add(1, Ordering::Relaxed) >= MAX_WAITING {
            self.queued.fetch_sub(1, Ordering::Relaxed);
            return;
        }
        // The worker may be gone.
        let _ = self.writer.send(WorkerEvent::StepRecord(Arc::clone(&self.key), record));
    }

    /// The worker has taken a record out of its queue.
    pub fn is_dequeued(&self) {
        self.queued.fetch_sub(1, Ordering::Relaxed);
    }

    /// Gives the session to its worker, with the records that have waited.
    pub fn follow(&self, session: Box<Followed>) {
        let mut stage = lock(&self.stage);
        let _ = self.writer.send(WorkerEvent::Follow(session));
        if let Stage::LookedFor(waiting) = std::mem::replace(&mut *stage, Stage::Followed) {
            waiting.into_iter().for_each(|record| self.enqueue(record));
        }
    }

    /// The session's token has appeared or gone.
    pub fn token(&self, is_there: bool) {
        let stage = lock(&self.stage);
        self.is_gone.store(!is_there, Ordering::Relaxed);
        if matches!(&*stage, Stage::Followed) {
            let key = Arc::clone(&self.key);
            let _ = self.writer.send(if is_there { WorkerEvent::Live(key) } else { WorkerEvent::Gone(key) });
        }
    }

    /// True if no record has come.
    pub fn is_silent(&self) -> bool {
        matches!(&*lock(&self.stage), Stage::Announced)
    }

    /// Number of the server's records that have come.
    pub fn heard(&self) -> u64 {
        self.heard.load(Ordering::Relaxed)
    }

    /// Takes these records once more: they are requested.
    pub fn expect(&self, from: u64, count: u64) {
        lock(&self.sieve).expect(from, count);
    }
}

/// The inlets of all announced sessions, by what their keys begin with.
///
/// A single subscription serves them all: each further one costs more, and anybody can announce sessions.
#[derive(Default)]
pub(super) struct Inlets(RwLock<BTreeMap<Arc<str>, Arc<Inlet>>>);

impl Inlets {
    pub fn get(&self, key: &str) -> Option<Arc<Inlet>> {
        self.0.read().unwrap_or_else(PoisonError::into_inner).get(key).cloned()
    }

    pub fn add(&self, inlet: &Arc<Inlet>) {
        let mut inlets = self.0.write().unwrap_or_else(PoisonError::into_inner);
        inlets.insert(Arc::clone(&inlet.key), Arc::clone(inlet));
    }

    pub fn remove(&self, inlet: &Arc<Inlet>) {
        let mut inlets = self.0.write().unwrap_or_else(PoisonError::into_inner);
        // Another one may have its key by now.
        if inlets.get(&inlet.key).is_some_and(|known| Arc::ptr_eq(known, inlet)) {
            inlets.remove(&inlet.key);
        }
    }
}

/// Unseals the messages of sessions, a turn of each; the body of a thread.
pub(super) fn unseal_all(inbox: &Receiver<Option<Arc<Inlet>>>) {
    let mut ready: VecDeque<Arc<Inlet>> = VecDeque::new();
    let mut pausing: VecDeque<(Instant, Arc<Inlet>)> = VecDeque::new();
    let mut is_stopping = false;
    loop {
        ready.extend(
            std::iter::from_fn(|| {
                let next = inbox.try_recv().ok()?;
                is_stopping |= next.is_none();
                Some(next)
            })
            .flatten(),
        );
        let now = Instant::now();
        while let Some((_, inlet)) = pausing.pop_front_if(|(until, _)| is_stopping || *until <= now) {
            ready.push_back(inlet);
        }
        let Some(inlet) = ready.pop_front() else {
            if is_stopping {
                return;
            }
            let pause = pausing.front().map_or(Duration::MAX, |(until, _)| until.saturating_duration_since(now));
            match inbox.recv_timeout(pause) {
                Ok(Some(inlet)) => ready.push_back(inlet),
                Ok(None) | Err(RecvTimeoutError::Disconnected) => is_stopping = true,
                Err(RecvTimeoutError::Timeout) => {}
            }
            continue;
        };
        match inlet.unseal() {
            (false, _) => {}
            (true, true) => pausing.push_back((now + PAUSE, inlet)),
            (true, false) => ready.push_back(inlet),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sieve_lets_each_record_through_once_unless_it_is_asked_for() {
        let mut sieve = Sieve::default();
        (0..5000).filter(|seq| *seq != 4000).for_each(|seq| sieve.note(seq));
        assert!(!sieve.is_new(0) && !sieve.is_new(4999), "both have come");
        assert!(sieve.is_new(4000) && sieve.is_new(5000));
        sieve.expect(3, 2);
        assert!(sieve.is_new(3) && sieve.is_new(4), "they are asked for, though long forgotten");
        sieve.expect(4998, u64::MAX);
        assert!(!sieve.is_new(4997) && sieve.is_new(4998) && sieve.is_new(4999));
    }

    #[test]
    fn a_lane_is_bounded_in_messages_and_bytes() {
        let mut lane = Lane::default();
        (0..100).for_each(|_| lane.push(&Bytes::from_static(&[0; 10]), 5, 1000));
        assert_eq!((lane.waiting.len(), lane.bytes), (5, 50));
        let mut lane = Lane::default();
        lane.push(&Bytes::from(vec![0; 300]), 5, 100);
        lane.push(&Bytes::from(vec![0; 1]), 5, 100);
        assert_eq!((lane.waiting.len(), lane.bytes), (1, 300), "a large one alone");
        assert!(lane.pop().is_some() && lane.pop().is_none() && lane.bytes == 0);
    }
}
