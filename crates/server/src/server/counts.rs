//! Figures of a running server, for those who operate it.

use std::sync::atomic::AtomicU64;

/// Counters since the server's start. Those of a step are not among them: a session numbers its records anyway.
#[derive(Debug, Default)]
pub(super) struct Tally {
    pub sessions: AtomicU64,
    /// Of sessions that are over.
    pub records: AtomicU64,
    pub bags: AtomicU64,
    pub cut_bags: AtomicU64,
}

/// Figures of a server. Totals are since its start.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Counts {
    pub open_sessions: usize,
    /// Largest number of open sessions.
    pub capacity: usize,
    /// Sessions that were opened.
    pub sessions: u64,
    /// Records of sessions: one for each control step, and few others.
    pub records: u64,
    /// Messages that did not come from a session's client, or came a second time.
    pub refused_messages: u64,
    /// Bags that its own recorder finished, and that it had to cut.
    pub bags: u64,
    pub cut_bags: u64,
}
