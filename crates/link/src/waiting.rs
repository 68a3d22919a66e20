//! Logs what a program waits for.

use std::fmt::Display;
use std::time::{Duration, Instant};

/// Time before the first line, and between two.
const PERIODS: [Duration; 2] = [Duration::from_secs(3), Duration::from_secs(30)];

/// A wait for another program, which is logged after 3 s and then every 30 s.
#[derive(Debug)]
pub struct WaitLog {
    next: Instant,
}

impl Default for WaitLog {
    fn default() -> Self {
        Self { next: Instant::now() + PERIODS[0] }
    }
}

impl WaitLog {
    /// Logs what the program waits for, if it is due; `what` is called only then.
    pub fn say<D: Display>(&mut self, what: impl FnOnce() -> D) {
        let now = Instant::now();
        if now >= self.next {
            self.next = now + PERIODS[1];
            tracing::warn!("waiting for {}", what());
        }
    }
}
