//! Progress with the time that is left, on a terminal only.

use std::io::{IsTerminal, Write};
use std::sync::Mutex;
use std::time::{Duration, Instant};

/// Nothing is shown before; short work needs no bar.
const QUIET: Duration = Duration::from_millis(700);
const PERIOD: Duration = Duration::from_millis(200);

/// A line on stderr that is written over and over.
pub struct ProgressLine {
    start: Instant,
    last: Mutex<Option<Instant>>,
    is_shown: bool,
}

impl ProgressLine {
    /// Starts to count the time.
    pub fn new() -> Self {
        Self { start: Instant::now(), last: Mutex::new(None), is_shown: std::io::stderr().is_terminal() }
    }

    /// Shows what is done, and of how much, in any unit.
    pub fn show(&self, label: &str, done: u64, all: u64) {
        let elapsed = self.start.elapsed();
        let Ok(mut last) = self.last.lock() else { return };
        if !self.is_shown || elapsed < QUIET || last.is_some_and(|last| last.elapsed() < PERIOD) {
            return;
        }
        *last = Some(Instant::now());
        let share = done as f64 / all.max(1) as f64;
        let left = if share > 0.0 { elapsed.as_secs_f64() * (1.0 / share - 1.0) } else { f64::NAN };
        let left = if left.is_finite() { format!(", {left:.0} s left") } else { String::new() };
        // A progress line that cannot be written is no reason to stop.
        let _ = write!(std::io::stderr(), "\r\x1b[K{label} ({:.0} %{left})", 100.0 * share);
    }

    /// Wipes the line.
    pub fn clear(&self) {
        if self.last.lock().is_ok_and(|last| last.is_some()) {
            let _ = write!(std::io::stderr(), "\r\x1b[K");
        }
    }
}
