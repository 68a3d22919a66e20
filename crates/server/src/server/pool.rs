//! Workers and a timer, which decide who runs a session, and when.

use std::cmp;
use std::collections::{BinaryHeap, VecDeque};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, PoisonError, Weak};
use std::time::Duration;

use fiatlux_access::SEAL_BYTES;
use fiatlux_carrier::{BusyWait, Query};
use fiatlux_proto::Bytes;

use super::actor::Actor;
use super::lock;
use super::opens::Digest;

pub(super) enum Job {
    Run(Arc<Actor>),
    /// A request to open a session, with the digest that identifies it.
    Open(Bytes, Vec<u8>, Digest),
    Describe(Query),
}

/// Replies of a session to a query.
pub(super) struct Answer {
    pub query: Query,
    pub kind: AnswerKind,
}

impl Answer {
    pub fn bytes(&self) -> usize {
        match &self.kind {
            AnswerKind::Replies(_, replies) => replies.iter().map(Bytes::len).sum(),
            AnswerKind::Own(_, _, bytes, _) | AnswerKind::Refusal(bytes) => bytes.len(),
        }
    }
}

pub(super) enum AnswerKind {
    /// Messages of this type.
    Replies(&'static str, Vec<Bytes>),
    /// A message of this type on the server's own key: of several replies with one key, a query for all servers may
    /// keep only the last. With its attachment, if any.
    Own(String, &'static str, Bytes, Option<[u8; SEAL_BYTES]>),
    /// A refusal that has no other form.
    Refusal(Bytes),
}

/// Jobs for threads, in order of arrival.
pub(super) struct Queue<T> {
    state: Mutex<QueueState<T>>,
    /// `next` has something to return; can be read without the lock.
    is_ready: AtomicBool,
    changed: Condvar,
}

struct QueueState<T> {
    work: VecDeque<T>,
    is_stopped: bool,
    /// A thread is polling for work, and so need not be woken.
    is_watched: bool,
}

impl<T> Default for Queue<T> {
    fn default() -> Self {
        let state = QueueState { work: VecDeque::new(), is_stopped: false, is_watched: false };
        Self { state: Mutex::new(state), is_ready: AtomicBool::new(false), changed: Condvar::new() }
    }
}

impl<T> Queue<T> {
    pub fn push(&self, work: T) {
        let mut state = lock(&self.state);
        state.work.push_back(work);
        self.is_ready.store(true, Ordering::Release);
        let is_seen = state.is_watched && state.work.len() == 1;
        drop(state);
        if !is_seen {
            self.changed.notify_one();
        }
    }

    /// The next job; `None` once the queue is stopped.
    pub fn next(&self) -> Option<T> {
        self.next_after(|| false)
    }

    /// As [`Queue::next`], but the thread polls for a moment before it sleeps.
    pub fn next_soon(&self, busy: &mut BusyWait) -> Option<T> {
        self.next_after(|| busy.until(|| self.is_ready.load(Ordering::Acquire)))
    }

    fn next_after(&self, mut watch: impl FnMut() -> bool) -> Option<T> {
        let mut state = lock(&self.state);
        loop {
            if state.is_stopped {
                return None;
            }
            if let Some(work) = state.work.pop_front() {
                self.is_ready.store(!state.work.is_empty(), Ordering::Release);
                return Some(work);
            }
            if !state.is_watched {
                state.is_watched = true;
                drop(state);
                let found = watch();
                state = lock(&self.state);
                state.is_watched = false;
                if found || state.is_stopped || !state.work.is_empty() {
                    continue;
                }
            }
            state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// Folds over the waiting jobs.
    pub fn fold<B>(&self, start: B, look: impl Fn(B, &T) -> B) -> B {
        lock(&self.state).work.iter().fold(start, look)
    }

    pub fn stop(&self) {
        let mut state = lock(&self.state);
        state.is_stopped = true;
        state.work.clear();
        self.is_ready.store(true, Ordering::Release);
        self.changed.notify_all();
    }
}

/// Wakes sessions at given times since the server's start.
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

    /// Runs until stopped; calls `wake` with each session whose time has come.
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
    fn partial_cmp(&self, other: &Self) -> Option<cmp::Ordering> {
        Some(self.cmp(other))
    }
}

/// The earliest alarm is the greatest, as the heap needs.
impl Ord for Alarm {
    fn cmp(&self, other: &Self) -> cmp::Ordering {
        other.at.cmp(&self.at)
    }
}
