//! Counters of the service.

use std::sync::atomic::{AtomicI64, AtomicU64};

/// Upper bounds of the buckets of request times, ms.
pub(crate) const BUCKETS_MS: [u64; 10] = [1, 2, 5, 10, 20, 50, 100, 500, 2_000, 10_000];

/// Counters since the start of the service; `metrics.rs` describes them.
#[derive(Debug, Default)]
pub(crate) struct Metrics {
    /// Responses by the first digit of their status, from 1.
    pub answers: [AtomicU64; 5],
    /// The last bucket counts requests over the largest bound.
    pub buckets: [AtomicU64; BUCKETS_MS.len() + 1],
    pub total_us: AtomicU64,
    pub open: AtomicI64,
    pub connections: AtomicI64,
    pub refused: AtomicU64,
    pub uploaded_bytes: AtomicU64,
    pub graded: AtomicU64,
    pub verified: AtomicU64,
    pub verified_steps: AtomicU64,
    pub verifying_ms: AtomicU64,
    pub retries: AtomicU64,
}
