//! Keeps strangers out of a session: checks each message of its client before it is queued, and seals each answer.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Mutex;
use std::time::Duration;

use fiatlux_access::{Channel, Label, Refused, SEAL_BYTES};
use fiatlux_carrier::Query;
use fiatlux_proto::Bytes;

use super::lock;

/// Number of answers kept for repeated queries. A client waits for one or two at a time.
const MAX_ANSWERED: usize = 8;
/// Largest number of copies of one query that may wait for its answer.
const MAX_COPIES: usize = 64;
/// Time between two lines in the log about refused messages.
const TELLING_PERIOD: Duration = Duration::from_secs(1);

/// The guard of one session. A copy of a client's query gets the answer of the first: whoever sees a query on the
/// network may send it before the client's own arrives.
pub(super) struct Gate(Mutex<State>);

struct State {
    channel: Channel,
    /// Queries that wait for the answer of each number.
    asked: BTreeMap<u64, Vec<Query>>,
    answered: VecDeque<(u64, Sealed)>,
    is_claimed: bool,
    told_at: Option<Duration>,
    told: u64,
}

/// An answer as it is sent.
#[derive(Clone)]
pub(super) struct Sealed {
    pub message: &'static str,
    pub bytes: Bytes,
    pub attachment: [u8; SEAL_BYTES],
}

pub(super) enum QueryCheck {
    /// It is to be answered, under this number.
    New(u64),
    /// It was answered before.
    Again(Box<Sealed>, Query),
    /// Nothing: it waits with an earlier copy, or its answer is forgotten.
    Nothing,
    /// It does not come from the client.
    Foreign(Query),
}

impl Gate {
    pub fn new(channel: Channel) -> Self {
        let (asked, answered) = (BTreeMap::new(), VecDeque::new());
        Self(Mutex::new(State { channel, asked, answered, is_claimed: false, told_at: None, told: 0 }))
    }

    /// True if a message comes from the client and is new.
    pub fn takes(&self, label: &str, payload: &[u8], attachment: &[u8]) -> bool {
        let mut state = lock(&self.0);
        let takes = state.channel.open(Label::Message(label), payload, attachment).is_ok();
        state.is_claimed |= takes;
        takes
    }

    pub fn ask(&self, label: &str, payload: &[u8], query: Query) -> QueryCheck {
        let mut state = lock(&self.0);
        match state.channel.open(Label::Message(label), payload, &query.attachment) {
            Ok(number) => {
                state.is_claimed = true;
                state.asked.insert(number, vec![query]);
                QueryCheck::New(number)
            }
            Err(Refused::Repeated(number) | Refused::Late(number)) => {
                if let Some(copies) = state.asked.get_mut(&number) {
                    if copies.len() < MAX_COPIES {
                        copies.push(query);
                    }
                    return QueryCheck::Nothing;
                }
                let known = state.answered.iter().find(|(answered, _)| *answered == number);
                known.map_or(QueryCheck::Nothing, |(_, sealed)| QueryCheck::Again(Box::new(sealed.clone()), query))
            }
            Err(Refused::Form | Refused::Forged) => QueryCheck::Foreign(query),
        }
    }

    /// Seals the answer to a query, for all who wait for it.
    pub fn answer(&self, label: &str, number: u64, message: &'static str, bytes: Bytes) -> (Sealed, Vec<Query>) {
        let mut state = lock(&self.0);
        let attachment = state.channel.seal(Label::Reply(label, number), &bytes);
        let sealed = Sealed { message, bytes, attachment };
        if state.answered.len() >= MAX_ANSWERED {
            state.answered.pop_front();
        }
        state.answered.push_back((number, sealed.clone()));
        (sealed, state.asked.remove(&number).unwrap_or_default())
    }

    /// Forgets a query without an answer: the client asks again.
    pub fn forget(&self, number: u64) {
        lock(&self.0).asked.remove(&number);
    }

    /// Forgets all queries, which then get no answer.
    pub fn forget_all(&self) {
        lock(&self.0).asked.clear();
    }

    /// The attachment for a message to the client.
    pub fn seal(&self, label: &str, payload: &[u8]) -> [u8; SEAL_BYTES] {
        lock(&self.0).channel.seal(Label::Message(label), payload)
    }

    /// True once anything from its client has arrived.
    pub fn is_claimed(&self) -> bool {
        lock(&self.0).is_claimed
    }

    /// Number of messages refused since the last report, at most once a second.
    pub fn refused(&self, now: Duration) -> Option<u64> {
        let mut state = lock(&self.0);
        let count = state.channel.refused() - state.told;
        if count == 0 || state.told_at.is_some_and(|at| now < at + TELLING_PERIOD) {
            return None;
        }
        state.told_at = Some(now);
        state.told += count;
        Some(count)
    }
}
