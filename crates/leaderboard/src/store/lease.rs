//! The durations of claims, duties and pauses.

use std::time::Duration;

/// Time after which a claim that is not renewed ends, by default and at most.
pub(crate) const LEASE: Duration = Duration::from_secs(20);
/// No claim or pause is longer. An end that is further away was written by a clock that ran ahead.
pub(super) const MAX_PAUSE: Duration = Duration::from_secs(24 * 3600);

/// The time after a pause, ms since 1970.
pub(super) fn after(now: i64, pause: Duration) -> i64 {
    now + pause.as_millis() as i64
}
