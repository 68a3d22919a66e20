//! One session among others: its inbox, which never grows without bound, and its way out.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use fiatlux_access::RowsKey;
use fiatlux_proto::keys::SessionKeys;
use fiatlux_proto::{encoding, limits};
use fiatlux_session::server::Input;
use fiatlux_session::{Machine as _, ServerSession};
use zenoh::bytes::Encoding;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::Publisher;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::query::Query;
use zenoh::sample::Locality;
use zenoh::{Session as Zenoh, Wait};

use super::gate::Gate;
use super::host::Simulation;
use super::lock;
use super::runs::Attempt;

/// A session whose replies go to those who asked over Zenoh.
pub(super) type Session = ServerSession<Simulation, Asker>;

/// Where a reply goes.
#[derive(Debug)]
pub(super) enum Asker {
    /// To the client's query on that key, of that number; the gate knows who waits for it.
    Client(&'static str, u64),
    /// To a recorder's query.
    Recorder(Query),
}

/// A session with its inbox. One worker at a time has it.
pub(super) struct Actor {
    pub id: String,
    pub session: Mutex<Session>,
    inbox: Mutex<Inbox>,
    /// Gone once the session is done.
    pub wire: Mutex<Option<Wire>>,
    /// Of the run whose episode it plays.
    pub attempt: Option<Arc<Attempt>>,
    pub gate: Arc<Gate>,
    /// Seals its records; without one they stay in this process.
    pub rows: Option<RowsKey>,
    /// Its records are for its opener.
    pub is_replay: bool,
    /// When it is closed unless somebody has claimed it.
    pub claim_by: Duration,
    /// Somebody withdrew the client's token since its last message, not always the client.
    pub token_gone: AtomicBool,
    /// The furthest acknowledgement so far.
    pub acknowledged: Mutex<Option<u64>>,
    /// Number of the next record.
    pub next_seq: AtomicU64,
}

#[derive(Default)]
struct Inbox {
    inputs: VecDeque<(Side, Input<Asker>)>,
    /// How many of each side wait.
    waiting: [usize; 3],
    dropped: u64,
    tick: bool,
    /// It is in the run queue, or a worker has it.
    scheduled: bool,
    /// The earliest time that the timer holds for it.
    wake_at: Option<Duration>,
}

/// Whose messages: each side has its own bound, so that a flood of one does not drown the other.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Side {
    Client,
    Recorder,
    /// The server's own, few and without a bound.
    Server,
}

impl Actor {
    pub fn new(id: String, session: Session, wire: Wire, gate: Gate, claim_by: Duration) -> Self {
        Self {
            id,
            session: Mutex::new(session),
            inbox: Mutex::default(),
            wire: Mutex::new(Some(wire)),
            attempt: None,
            gate: Arc::new(gate),
            rows: None,
            is_replay: false,
            claim_by,
            token_gone: AtomicBool::new(false),
            acknowledged: Mutex::new(None),
            next_seq: AtomicU64::new(0),
        }
    }

    /// Whether nobody has claimed it in time.
    pub fn is_unclaimed(&self, now: Duration) -> bool {
        now >= self.claim_by && !self.gate.is_claimed()
    }

    /// When it has to be looked at.
    pub fn wake_at(&self, session: &Session, now: Duration) -> Option<Duration> {
        let claim = (now < self.claim_by && !self.gate.is_claimed()).then_some(self.claim_by);
        session.wake_at().into_iter().chain(claim).min()
    }

    /// Whether its client shows by a message that it is there, after its token was withdrawn.
    pub fn shows_up(&self) -> bool {
        self.token_gone.load(Ordering::Relaxed) && self.token_gone.swap(false, Ordering::Relaxed)
    }

    /// Takes a message in; returns whether the session has to be scheduled. Messages over the limit are counted and dropped.
    #[must_use]
    pub fn push(&self, side: Side, input: Input<Asker>) -> bool {
        let mut inbox = lock(&self.inbox);
        let waiting = &mut inbox.waiting[side as usize];
        if side != Side::Server && *waiting >= limits::MAX_WAITING_MESSAGES {
            inbox.dropped += u64::from(side == Side::Client);
            if let Input::Reset(_, Asker::Client(_, number))
            | Input::Close(_, Asker::Client(_, number))
            | Input::Look(_, Asker::Client(_, number))
            | Input::Observation(Asker::Client(_, number)) = input
            {
                self.gate.forget(number);
            }
        } else {
            *waiting += 1;
            inbox.inputs.push_back((side, input));
        }
        !std::mem::replace(&mut inbox.scheduled, true)
    }

    /// The time has come that the session asked for.
    #[must_use]
    pub fn tick(&self) -> bool {
        let mut inbox = lock(&self.inbox);
        inbox.wake_at = None;
        inbox.tick = true;
        !std::mem::replace(&mut inbox.scheduled, true)
    }

    /// Takes the next input from the inbox; a tick comes first.
    pub fn take(&self) -> Option<Input<Asker>> {
        let mut inbox = lock(&self.inbox);
        if std::mem::take(&mut inbox.tick) {
            return Some(Input::Tick);
        }
        if let Some((side, input)) = inbox.inputs.pop_front() {
            inbox.waiting[side as usize] -= 1;
            return Some(input);
        }
        let count = std::mem::take(&mut inbox.dropped);
        (count > 0).then_some(Input::Dropped(count))
    }

    /// Whether the worker may leave it: nothing has come meanwhile.
    pub fn park(&self) -> bool {
        let mut inbox = lock(&self.inbox);
        inbox.scheduled = inbox.tick || inbox.dropped > 0 || !inbox.inputs.is_empty();
        !inbox.scheduled
    }

    /// Whether the timer has to be told of a time; it holds an earlier one otherwise.
    #[must_use]
    pub fn wakes_earlier(&self, at: Duration) -> bool {
        let mut inbox = lock(&self.inbox);
        let earlier = inbox.wake_at.is_none_or(|known| at < known);
        if earlier {
            inbox.wake_at = Some(at);
        }
        earlier
    }
}

/// What a session sends with.
pub(super) struct Wire {
    pub observation: Publisher<'static>,
    pub notice: Publisher<'static>,
    pub truth: Publisher<'static>,
    _live: Option<LivelinessToken>,
}

impl Wire {
    /// Every message may be dropped on the way, and is asked for again then: a peer that does not read costs the server
    /// nothing but that. Records leave the process sealed alone. Recorders do not look for a session that `is_replay`.
    pub fn declare(zenoh: &Zenoh, keys: &SessionKeys, is_sealed: bool, is_replay: bool) -> zenoh::Result<Self> {
        let records_to = if is_sealed { Locality::Any } else { Locality::SessionLocal };
        let publisher = |key: String, message: &str, priority: Priority, express: bool, to: Locality| {
            zenoh
                .declare_publisher(key)
                .encoding(Encoding::from(encoding(message)))
                .congestion_control(CongestionControl::Drop)
                .priority(priority)
                .express(express)
                .allowed_destination(to)
                .wait()
        };
        Ok(Self {
            observation: publisher(keys.observation(), "Observation", Priority::InteractiveHigh, true, Locality::Any)?,
            notice: publisher(keys.notice(), "Notice", Priority::InteractiveHigh, true, Locality::Any)?,
            truth: publisher(keys.truth_row(), "StepRecord", Priority::Data, false, records_to)?,
            _live: (!is_replay).then(|| zenoh.liveliness().declare_token(keys.live()).wait()).transpose()?,
        })
    }
}
