//! Workers and a timer: who runs a session, and when.

use std::cmp::Ordering;
use std::collections::{BinaryHeap, VecDeque};
use std::sync::{Arc, Condvar, Mutex, PoisonError, Weak};
use std::time::Duration;

use fiatlux_proto::Bytes;
use zenoh::query::Query;

use super::actor::Actor;
use super::lock;

/// What a worker does.
pub(super) enum Job {
    Run(Arc<Actor>),
    Open(Query),
    Describe(Query),
}

/// Replies that a session has for a query.
pub(super) struct Answer {
    pub query: Query,
    pub kind: AnswerKind,
}

impl Answer {
    pub fn bytes(&self) -> usize {
        match &self.kind {
            AnswerKind::Replies(_, replies) => replies.iter().map(Bytes::len).sum(),
            AnswerKind::Own(_, _, bytes) | AnswerKind::Refusal(bytes) => bytes.len(),
        }
    }
}

pub(super) enum AnswerKind {
    /// Messages of that name.
    Replies(&'static str, Vec<Bytes>),
    /// A message of that name, on that key: of replies with one key, a query for all servers may keep the last alone.
    Own(String, &'static str, Bytes),
    /// A refusal where there is no other form for it.
    Refusal(Bytes),
}

/// Work for threads, in the order in which it came.
pub(super) struct Queue<T> {
    state: Mutex<(VecDeque<T>, bool)>,
    changed: Condvar,
}

impl<T> Default for Queue<T> {
    fn default() -> Self {
        Self { state: Mutex::new((VecDeque::new(), false)), changed: Condvar::new() }
    }
}

impl<T> Queue<T> {
    pub fn push(&self, work: T) {
        lock(&self.state).0.push_back(work);
        self.changed.notify_one();
    }

    /// What comes next; none once the queue is stopped.
    pub fn next(&self) -> Option<T> {
        let mut state = lock(&self.state);
        loop {
            if state.1 {
                return None;
            }
            if let Some(work) = state.0.pop_front() {
                return Some(work);
            }
            state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// Looks at what waits.
    pub fn fold<B>(&self, start: B, look: impl Fn(B, &T) -> B) -> B {
        lock(&self.state).0.iter().fold(start, look)
    }

    pub fn stop(&self) {
        let mut state = lock(&self.state);
        state.1 = true;
        state.0.clear();
        self.changed.notify_all();
    }
}

/// Wakes sessions at times since the server's start.
#[derive(Default)]
pub(super) struct Timer {
    state: Mutex<(BinaryHeap<Alarm>, bool)>,
    changed: Condvar,
}

struct Alarm {
    at: Duration,
    actor: Weak<Actor>,
}

impl Timer {
    pub fn set(&self, at: Duration, actor: &Arc<Actor>) {
        let mut state = lock(&self.state);
        let first = state.0.peek().is_none_or(|alarm| at < alarm.at);
        state.0.push(Alarm { at, actor: Arc::downgrade(actor) });
        if first {
            self.changed.notify_one();
        }
    }

    /// Runs until stopped; `wake` takes the sessions whose time has come.
    pub fn run(&self, now: impl Fn() -> Duration, wake: impl Fn(Arc<Actor>)) {
        let mut state = lock(&self.state);
        while !state.1 {
            let time = now();
            match state.0.peek().map(|alarm| alarm.at) {
                None => state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner),
                Some(at) if at > time => {
                    let wait = self.changed.wait_timeout(state, at - time);
                    state = wait.unwrap_or_else(PoisonError::into_inner).0;
                }
                Some(_) => {
                    let actor = state.0.pop().and_then(|alarm| alarm.actor.upgrade());
                    drop(state);
                    actor.into_iter().for_each(&wake);
                    state = lock(&self.state);
                }
            }
        }
    }

    pub fn stop(&self) {
        lock(&self.state).1 = true;
        self.changed.notify_all();
    }
}

impl PartialEq for Alarm {
    fn eq(&self, other: &Self) -> bool {
        self.at == other.at
    }
}

impl Eq for Alarm {}

impl PartialOrd for Alarm {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

/// The earliest is the greatest, as the heap has it.
impl Ord for Alarm {
    fn cmp(&self, other: &Self) -> Ordering {
        other.at.cmp(&self.at)
    }
}
