//! What the service counts.

use std::sync::atomic::{AtomicI64, AtomicU64};

/// Upper bounds of the buckets of request times, ms.
pub(crate) const BUCKETS_MS: [u64; 10] = [1, 2, 5, 10, 20, 50, 100, 500, 2_000, 10_000];

/// Counters since the start of the service.
#[derive(Debug, Default)]
pub(crate) struct Metrics {
    /// Responses by the first digit of their status, from 1.
    pub answers: [AtomicU64; 5],
    /// The last bucket counts requests over the largest bound.
    pub buckets: [AtomicU64; BUCKETS_MS.len() + 1],
    pub total_us: AtomicU64,
    /// Requests that are being answered now.
    pub open: AtomicI64,
    /// Connections that are open now.
    pub connections: AtomicI64,
    /// Connections and requests that were refused because their address has too many.
    pub refused: AtomicU64,
    /// Bytes of files received.
    pub uploaded_bytes: AtomicU64,
    /// Submissions that were graded, including refused ones.
    pub graded: AtomicU64,
    /// Episodes whose verification has a verdict.
    pub verified: AtomicU64,
    /// Control steps simulated to verify episodes.
    pub verified_steps: AtomicU64,
    /// Time spent verifying, ms, summed over parallel workers.
    pub verifying_ms: AtomicU64,
    /// Verifications that failed without a verdict and are tried again.
    pub retries: AtomicU64,
}
