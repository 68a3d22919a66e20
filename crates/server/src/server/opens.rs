//! Requests that start something: each is carried out once, however many copies of it arrive.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Mutex;

use fiatlux_access::{SEAL_BYTES, hash};
use fiatlux_carrier::Query;
use fiatlux_proto::Bytes;

use super::lock;

/// Number of answers kept for copies of their requests.
const MAX_ANSWERED: usize = 256;
/// Largest number of copies of one request that may wait for its answer.
const MAX_COPIES: usize = 64;

/// Identifies a request by its bytes: a client draws a new hello for each request.
pub(super) type Digest = [u8; 32];

/// Recent requests and their answers.
#[derive(Default)]
pub(super) struct Opens(Mutex<State>);

#[derive(Default)]
struct State {
    requests: BTreeMap<Digest, Request>,
    answered: VecDeque<Digest>,
}

enum Request {
    Waits(Vec<Query>),
    Answered(Begun),
}

/// The answer to a request.
#[derive(Clone)]
pub(super) struct Begun {
    pub message: &'static str,
    pub bytes: Bytes,
    /// Code of the answer, for a request to a run.
    pub attachment: Option<[u8; SEAL_BYTES]>,
}

/// Result of the check of a request to open a session.
pub(super) enum OpenCheck {
    /// It is to be carried out.
    New,
    /// It was carried out before, with this answer.
    Again(Box<Begun>, Query),
    /// It waits with an earlier copy.
    Joined,
}

impl Opens {
    pub fn digest(payload: &[u8], attachment: &[u8]) -> Digest {
        let mut digest = [0; 32];
        let length = (payload.len() as u64).to_le_bytes();
        digest.copy_from_slice(hash(&[&length, payload, attachment]).as_ref());
        digest
    }

    pub fn take(&self, digest: Digest, query: Query) -> OpenCheck {
        let mut state = lock(&self.0);
        match state.requests.get_mut(&digest) {
            None => {
                state.requests.insert(digest, Request::Waits(vec![query]));
                OpenCheck::New
            }
            Some(Request::Waits(copies)) => {
                if copies.len() < MAX_COPIES {
                    copies.push(query);
                }
                OpenCheck::Joined
            }
            Some(Request::Answered(begun)) => OpenCheck::Again(Box::new(begun.clone()), query),
        }
    }

    /// Keeps the answer; returns the queries that wait for it.
    pub fn answer(&self, digest: Digest, begun: Begun) -> Vec<Query> {
        let mut state = lock(&self.0);
        let waiting = state.requests.insert(digest, Request::Answered(begun));
        state.answered.push_back(digest);
        if state.answered.len() > MAX_ANSWERED
            && let Some(oldest) = state.answered.pop_front()
        {
            state.requests.remove(&oldest);
        }
        match waiting {
            Some(Request::Waits(queries)) => queries,
            _ => Vec::new(),
        }
    }

    /// Forgets a request that was not carried out, so that it may be sent again.
    pub fn forget(&self, digest: &Digest) {
        lock(&self.0).requests.remove(digest);
    }
}
