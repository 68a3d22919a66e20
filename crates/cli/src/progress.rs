//! Shows the progress of long work on stderr.

use std::fmt::Display;
use std::io::{IsTerminal, Write};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Time between two updates on a terminal.
const TERMINAL_PERIOD: Duration = Duration::from_millis(200);
/// Time between two lines elsewhere, such as in the log of a CI run.
const LINE_PERIOD: Duration = Duration::from_secs(10);

/// A line that is overwritten on a terminal, and an occasional line elsewhere. Short work shows nothing.
#[derive(Debug)]
pub struct ProgressLine {
    start: Instant,
    is_terminal: bool,
    /// When to show the next update, and whether one is on the screen.
    state: Mutex<(Instant, bool)>,
}

impl Default for ProgressLine {
    fn default() -> Self {
        let is_terminal = std::io::stderr().is_terminal();
        let period = if is_terminal { TERMINAL_PERIOD } else { LINE_PERIOD };
        let start = Instant::now();
        Self { start, is_terminal, state: Mutex::new((start + period, false)) }
    }
}

impl ProgressLine {
    /// Shows the progress if an update is due; `look` is called only then.
    pub fn show<D: Display>(&self, look: impl FnOnce() -> D) {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        let now = Instant::now();
        if now < state.0 {
            return;
        }
        // A closed stderr does not stop the program.
        if self.is_terminal {
            *state = (now + TERMINAL_PERIOD, true);
            let _ = write!(std::io::stderr(), "\r\x1b[K{}", look());
        } else {
            *state = (now + LINE_PERIOD, false);
            let _ = writeln!(std::io::stderr(), "{}", look());
        }
    }

    /// Estimated time left after `done` of `all`, as minutes and seconds.
    pub fn left(&self, done: u64, all: u64) -> String {
        let per_unit = self.start.elapsed().as_secs_f64() / done.max(1) as f64;
        let left = (per_unit * all.saturating_sub(done) as f64) as u64;
        format!("{}:{:02}", left / 60, left % 60)
    }

    /// Units of work for each second since the start.
    pub fn rate(&self, done: u64) -> f64 {
        done as f64 / self.start.elapsed().as_secs_f64().max(1e-9)
    }

    /// Clears the line, so that other text can follow.
    pub fn clear(&self) {
        self.write_over(|| ());
    }

    /// Clears the line and writes other text, which no update interrupts.
    pub fn write_over<T>(&self, write: impl FnOnce() -> T) -> T {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        if std::mem::take(&mut state.1) {
            let _ = write!(std::io::stderr(), "\r\x1b[K");
        }
        write()
    }
}
