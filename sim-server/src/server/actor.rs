//! One session among others: its inbox, which never grows without bound, and its way out.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use fiatlux_proto::keys::SessionKeys;
use fiatlux_proto::{encoding, limits};
use fiatlux_session::ServerSession;
use fiatlux_session::server::Input;
use zenoh::bytes::Encoding;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::Publisher;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::query::Query;
use zenoh::sample::Locality;
use zenoh::{Session as Zenoh, Wait};

use super::host::Simulation;
use super::lock;
use super::runs::Attempt;

/// A session whose replies go to Zenoh's queries.
pub(super) type Session = ServerSession<Simulation, Query>;

/// A session with its inbox. One worker at a time has it.
pub(super) struct Actor {
    pub id: String,
    pub session: Mutex<Session>,
    inbox: Mutex<Inbox>,
    /// Gone once the session is done.
    pub wire: Mutex<Option<Wire>>,
    /// Of the run whose episode it plays.
    pub attempt: Option<Arc<Attempt>>,
}

#[derive(Default)]
struct Inbox {
    inputs: VecDeque<(Side, Input<Query>)>,
    /// How many of each side wait.
    waiting: [usize; 3],
    dropped: u64,
    tick: bool,
    /// It stands in the run queue, or a worker has it.
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
    pub fn new(id: String, session: Session, wire: Wire, attempt: Option<Arc<Attempt>>) -> Self {
        Self { id, session: Mutex::new(session), inbox: Mutex::default(), wire: Mutex::new(Some(wire)), attempt }
    }

    /// Takes a message in; returns whether the session has to be scheduled. Messages over the limit are counted and dropped.
    #[must_use]
    pub fn push(&self, side: Side, input: Input<Query>) -> bool {
        let mut inbox = lock(&self.inbox);
        let waiting = &mut inbox.waiting[side as usize];
        if side != Side::Server && *waiting >= limits::MAX_WAITING_MESSAGES {
            inbox.dropped += u64::from(side == Side::Client);
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

    /// The next input.
    pub fn take(&self) -> Option<Input<Query>> {
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
    _live: LivelinessToken,
}

impl Wire {
    /// Every message may be dropped on the way, and is asked for again then: a peer that does not read costs the server
    /// nothing but that. The records of a run are for the server's own recorder: they tell the seed.
    pub fn declare(zenoh: &Zenoh, keys: &SessionKeys, is_of_run: bool) -> zenoh::Result<Self> {
        let records_to = if is_of_run { Locality::SessionLocal } else { Locality::Any };
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
            _live: zenoh.liveliness().declare_token(keys.live()).wait()?,
        })
    }
}
