//! How far an episode is, on stderr: one line that is rewritten on a terminal, a line now and then elsewhere.

use std::io::{IsTerminal, Write};
use std::time::{Duration, Instant};

/// Progress of one episode.
pub struct Progress {
    episode: u64,
    horizon: u64,
    start: Instant,
    next: Instant,
    period: Duration,
    terminal: bool,
    shown: bool,
}

impl Progress {
    pub fn new(episode: u64, horizon: u64) -> Self {
        let (terminal, start) = (std::io::stderr().is_terminal(), Instant::now());
        let period = Duration::from_millis(if terminal { 200 } else { 10_000 });
        Self { episode, horizon, start, next: start + period, period, terminal, shown: false }
    }

    pub fn at(&mut self, step: u64) {
        let now = Instant::now();
        if now < self.next {
            return;
        }
        self.next = now + self.period;
        let per_s = step as f64 / (now - self.start).as_secs_f64().max(1e-9);
        let left_s = self.horizon.saturating_sub(step) as f64 / per_s.max(1e-9);
        let (episode, horizon) = (self.episode, self.horizon);
        let line =
            format!("episode {episode}: step {step} of {horizon}, {per_s:.0} steps/s, at most {left_s:.0} s left");
        let (before, after) = if self.terminal { ("\r\x1b[K", "") } else { ("", "\n") };
        self.show(&format!("{before}{line}{after}"));
    }

    /// Clears the line.
    pub fn finish(&mut self) {
        if self.terminal && self.shown {
            self.show("\r\x1b[K");
        }
    }

    fn show(&mut self, text: &str) {
        self.shown = true;
        let mut stderr = std::io::stderr();
        // A stderr that is gone is no reason to stop.
        let _ = stderr.write_all(text.as_bytes()).and_then(|()| stderr.flush());
    }
}
