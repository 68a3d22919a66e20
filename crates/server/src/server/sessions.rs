//! The sessions of a server: those that are open, their places, and the gates of the last closed ones.

use std::collections::{BTreeMap, VecDeque};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError, RwLock};

use super::actor::Actor;
use super::gate::Gate;
use super::lock;
use super::places::Places;

/// Number of closed sessions to remember, whose clients may still ask.
const MAX_FORMER: usize = 256;

pub(super) struct Sessions {
    pub capacity: usize,
    open: RwLock<BTreeMap<String, Arc<Actor>>>,
    /// Gates of closed sessions, oldest first: their clients are told that the session is over.
    former: Mutex<VecDeque<(String, Arc<Gate>)>>,
    pub places: Places,
    /// Distinguishes the ids of sessions from those of an earlier server of the same name.
    id_prefix: String,
    next_id: AtomicU64,
}

impl Sessions {
    pub fn new(capacity: usize) -> Self {
        Self {
            capacity,
            open: RwLock::default(),
            former: Mutex::default(),
            places: Places::new(capacity),
            // Drawn, not the time: a machine's clock may be set back to when an earlier server of this name ran. A system without
            // random numbers fails at the first handshake, which says so.
            id_prefix: format!("{:012x}", getrandom::u64().unwrap_or_default() >> 16),
            next_id: AtomicU64::new(1),
        }
    }

    pub fn new_id(&self) -> String {
        format!("{}-{}", self.id_prefix, self.next_id.fetch_add(1, Ordering::Relaxed))
    }

    pub fn find(&self, id: &str) -> Option<Arc<Actor>> {
        self.open.read().unwrap_or_else(PoisonError::into_inner).get(id).cloned()
    }

    pub fn all(&self) -> Vec<Arc<Actor>> {
        self.open.read().unwrap_or_else(PoisonError::into_inner).values().cloned().collect()
    }

    /// Number of sessions, with those that are over but wait for their recorder.
    pub fn count(&self) -> usize {
        self.open.read().unwrap_or_else(PoisonError::into_inner).len()
    }

    pub fn add(&self, actor: &Arc<Actor>) {
        self.open.write().unwrap_or_else(PoisonError::into_inner).insert(actor.id.clone(), Arc::clone(actor));
    }

    /// Removes a session, frees its place and remembers its gate; returns whether it was there.
    pub fn remove(&self, actor: &Actor) -> bool {
        let removed = self.open.write().unwrap_or_else(PoisonError::into_inner).remove(&actor.id);
        self.places.leave(&actor.id);
        actor.gate.forget_all();
        let mut former = lock(&self.former);
        if former.len() >= MAX_FORMER {
            former.pop_front();
        }
        former.push_back((actor.id.clone(), Arc::clone(&actor.gate)));
        removed.is_some()
    }

    pub fn former(&self, id: &str) -> Option<Arc<Gate>> {
        lock(&self.former).iter().find(|(former, _)| former == id).map(|(_, gate)| Arc::clone(gate))
    }
}
