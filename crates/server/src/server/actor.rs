//! One session among others: its bounded inbox, and its outgoing messages.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use fiatlux_access::RowsKey;
use fiatlux_carrier::{Carrier, CarrierError, Declaration, Priority, Publisher, Quality, Query, Reach};
use fiatlux_proto::keys::SessionKeys;
use fiatlux_proto::limits;
use fiatlux_session::server::Input;
use fiatlux_session::{Machine as _, ServerSession};

use super::gate::Gate;
use super::host::Simulation;
use super::lock;
use super::runs::Attempt;

/// A session whose replies go to those who asked.
pub(super) type Session = ServerSession<Simulation, ReplyTo>;

#[derive(Debug)]
pub(super) enum ReplyTo {
    /// The client's query on this key with this number; the gate knows who waits for it.
    Client(&'static str, u64),
    Recorder(Query),
}

/// A session with its inbox. One worker at a time has it.
pub(super) struct Actor {
    pub id: String,
    pub session: Mutex<Session>,
    inbox: Mutex<Inbox>,
    pub wire: Mutex<WireState>,
    /// The attempt at an episode of a run that it plays, if any.
    pub attempt: Option<Arc<Attempt>>,
    pub gate: Arc<Gate>,
    /// Seals the session's records; without it they stay in this process.
    pub rows: Option<RowsKey>,
    /// Only the session's opener gets its records.
    pub is_replay: bool,
    /// Time at which it is closed unless somebody has claimed it.
    pub claim_by: Duration,
    /// The client's token was withdrawn since its last message, not necessarily by the client.
    pub token_gone: AtomicBool,
    /// The furthest acknowledgement so far, and the last episode that its recorder could not write.
    pub acknowledged: Mutex<Option<(u64, Option<u64>)>>,
    /// Number of the next record.
    pub next_seq: AtomicU64,
}

#[derive(Default)]
struct Inbox {
    inputs: VecDeque<(Side, Input<ReplyTo>)>,
    /// Number of waiting messages of each side.
    waiting: [usize; 3],
    dropped: u64,
    tick: bool,
    /// It is in the run queue, or a worker has it.
    scheduled: bool,
    /// The earliest time for which the timer holds it.
    wake_at: Option<Duration>,
}

/// Sender of a message: each side has its own limit, so that a flood of one does not drown the other.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Side {
    Client,
    Recorder,
    /// The server's own messages, which are few and have no limit.
    Server,
}

impl Actor {
    /// A session whose keys are not declared yet.
    pub fn new(id: String, session: Session, gate: Gate, claim_by: Duration) -> Self {
        Self {
            id,
            session: Mutex::new(session),
            inbox: Mutex::default(),
            wire: Mutex::new(WireState::Unclaimed),
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

    /// True once the time to claim it has passed.
    pub fn is_unclaimed(&self, now: Duration) -> bool {
        now >= self.claim_by && !self.gate.is_claimed()
    }

    /// When the session needs attention.
    pub fn wake_at(&self, session: &Session, now: Duration) -> Option<Duration> {
        let claim = (now < self.claim_by && !self.gate.is_claimed()).then_some(self.claim_by);
        session.wake_at().into_iter().chain(claim).min()
    }

    /// True if a message of its client has just shown that it exists, after its token was withdrawn.
    pub fn shows_up(&self) -> bool {
        self.token_gone.load(Ordering::Relaxed) && self.token_gone.swap(false, Ordering::Relaxed)
    }

    /// Takes in a message; returns whether the session must be scheduled. Messages over the limit are counted and
    /// dropped.
    #[must_use]
    pub fn push(&self, side: Side, input: Input<ReplyTo>) -> bool {
        let mut inbox = lock(&self.inbox);
        let waiting = &mut inbox.waiting[side as usize];
        if side != Side::Server && *waiting >= limits::MAX_WAITING_MESSAGES {
            inbox.dropped += u64::from(side == Side::Client);
            if let Input::Reset(_, ReplyTo::Client(_, number))
            | Input::Close(_, ReplyTo::Client(_, number))
            | Input::Look(_, ReplyTo::Client(_, number))
            | Input::Observation(ReplyTo::Client(_, number)) = input
            {
                self.gate.forget(number);
            }
        } else {
            *waiting += 1;
            inbox.inputs.push_back((side, input));
        }
        !std::mem::replace(&mut inbox.scheduled, true)
    }

    /// Notes that the time has come for which the session asked.
    #[must_use]
    pub fn tick(&self) -> bool {
        let mut inbox = lock(&self.inbox);
        inbox.wake_at = None;
        inbox.tick = true;
        !std::mem::replace(&mut inbox.scheduled, true)
    }

    /// Takes the next input from the inbox; a tick comes first.
    pub fn take(&self) -> Option<Input<ReplyTo>> {
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

    pub fn has_from_client(&self) -> bool {
        lock(&self.inbox).waiting[Side::Client as usize] > 0
    }

    /// True if the worker may leave it, because nothing has arrived meanwhile.
    pub fn park(&self) -> bool {
        let mut inbox = lock(&self.inbox);
        inbox.scheduled = inbox.tick || inbox.dropped > 0 || !inbox.inputs.is_empty();
        !inbox.scheduled
    }

    /// True if the timer needs this time, because it holds no earlier one.
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

/// Declarations of a session on the network.
pub(super) enum WireState {
    /// Nothing: nobody has claimed it. Each declaration costs all peers, and anybody can open sessions.
    Unclaimed,
    Declared(Wire),
    /// Nothing any more: the session is done.
    Closed,
}

impl WireState {
    pub fn declared(&self) -> Option<&Wire> {
        match self {
            Self::Declared(wire) => Some(wire),
            Self::Unclaimed | Self::Closed => None,
        }
    }

    pub fn is_closed(&self) -> bool {
        matches!(self, Self::Closed)
    }

    /// Closes it; what it has declared ends with what is returned.
    pub fn close(&mut self) -> Self {
        std::mem::replace(self, Self::Closed)
    }
}

/// The publishers and tokens of a session.
pub(super) struct Wire {
    pub observation: Publisher,
    pub notice: Publisher,
    pub truth: Publisher,
    _tokens: Vec<Declaration>,
}

impl Wire {
    /// True if anybody follows the records as they are made. Others may still ask for those that are kept.
    pub fn has_follower(&self) -> bool {
        self.truth.has_subscribers()
    }

    /// Every message may be dropped on the way and is then requested again: a peer that does not read costs the server
    /// nothing more. Records leave the process only sealed.
    pub fn declare(
        carrier: &Carrier,
        keys: &SessionKeys,
        is_sealed: bool,
        tokens: &[String],
    ) -> Result<Self, CarrierError> {
        let records_to = if is_sealed { Reach::Everywhere } else { Reach::ThisProcess };
        let to_client = Quality { priority: Priority::Interactive, express: true, blocking: false };
        Ok(Self {
            observation: carrier.publisher(&keys.observation(), "Observation", to_client, Reach::Everywhere)?,
            notice: carrier.publisher(&keys.notice(), "Notice", to_client, Reach::Everywhere)?,
            truth: carrier.publisher(&keys.truth_row(), "StepRecord", Quality::default(), records_to)?,
            _tokens: tokens.iter().map(|key| carrier.token(key)).collect::<Result<_, _>>()?,
        })
    }
}
