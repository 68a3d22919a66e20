//! The beat at which states and commands are sent.

use std::time::{Duration, Instant};

use crate::PERIOD_S;

/// Time between two.
pub(crate) const PERIOD: Duration = Duration::from_micros((PERIOD_S * 1e6) as u64);

/// Waits from beat to beat.
pub(crate) struct Ticks {
    next: Instant,
}

impl Ticks {
    pub fn begin() -> Self {
        Self { next: Instant::now() }
    }

    /// Until the next beat. After a pause of the machine they do not come in a burst.
    pub fn wait(&mut self) {
        self.next += PERIOD;
        match self.next.checked_duration_since(Instant::now()) {
            Some(left) => std::thread::sleep(left),
            None => self.next = Instant::now(),
        }
    }
}
