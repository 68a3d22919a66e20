//! Shows the progress of long work on stderr.

use std::fmt::Display;
use std::io::{IsTerminal, Write};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Time between two updates on a terminal.
const TERMINAL_PERIOD: Duration = Duration::from_millis(200);
/// Time between two lines elsewhere, such as in the log of a CI run.
const LINE_PERIOD: Duration = Duration::from_secs(10);

/// Time in which the estimated end follows a change of pace, s.
const SETTLING_S: f64 = 10.0;

/// A line that is overwritten on a terminal, and an occasional line elsewhere. Short work shows nothing.
#[derive(Debug)]
pub struct ProgressLine {
    start: Instant,
    is_terminal: bool,
    /// Time of the next update, and whether one is on the screen.
    state: Mutex<(Instant, bool)>,
    end: Mutex<End>,
}

impl Default for ProgressLine {
    fn default() -> Self {
        let is_terminal = std::io::stderr().is_terminal();
        let period = if is_terminal { TERMINAL_PERIOD } else { LINE_PERIOD };
        let start = Instant::now();
        Self { start, is_terminal, state: Mutex::new((start + period, false)), end: Mutex::default() }
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
            let columns = terminal_size::terminal_size_of(std::io::stderr()).map_or(80, |(width, _)| width.0.into());
            let _ = write!(std::io::stderr(), "\r\x1b[K{}", fitted(&look().to_string(), columns));
        } else {
            *state = (now + LINE_PERIOD, false);
            let _ = writeln!(std::io::stderr(), "{}", look());
        }
    }

    /// Estimated time left after `done` of `all`, as minutes and seconds. It follows a change of pace gradually.
    pub fn left(&self, done: u64, all: u64) -> String {
        let mut end = self.end.lock().unwrap_or_else(PoisonError::into_inner);
        let left = end.left_s(self.start.elapsed().as_secs_f64(), done, all) as u64;
        format!("{}:{:02}", left / 60, left % 60)
    }

    /// Units of work per second since the start.
    pub fn rate(&self, done: u64) -> f64 {
        done as f64 / self.start.elapsed().as_secs_f64().max(1e-9)
    }

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

/// The expected end of work, smoothed: an episode that ends long before its horizon does not make it jump.
#[derive(Debug, Default)]
struct End {
    /// Time of the last estimate, and the smoothed end, s after the start.
    last: Option<(f64, f64)>,
}

impl End {
    /// Estimated time left at a time after the start, s.
    fn left_s(&mut self, now_s: f64, done: u64, all: u64) -> f64 {
        let left_s = now_s / done.max(1) as f64 * all.saturating_sub(done) as f64;
        let (then_s, end_s) = self.last.unwrap_or((0.0, now_s + left_s));
        let weight = ((now_s - then_s) / SETTLING_S.min(now_s.max(1e-3))).min(1.0);
        let end_s = end_s + weight * (now_s + left_s - end_s);
        self.last = Some((now_s, end_s));
        if left_s == 0.0 { 0.0 } else { (end_s - now_s).max(0.0) }
    }
}

/// A line that a terminal does not wrap.
fn fitted(line: &str, columns: usize) -> String {
    if line.chars().count() < columns {
        return line.to_owned();
    }
    let mut kept: String = line.chars().take(columns.saturating_sub(4)).collect();
    kept.push_str("...");
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_is_shorter_than_the_terminal_is_wide() {
        assert_eq!(fitted("1/2 episodes", 80), "1/2 episodes");
        for columns in [12, 40, 80] {
            let line = fitted(&"S05/1000 at 12 s  ".repeat(9), columns);
            assert!(line.chars().count() < columns && line.ends_with("..."), "{line}");
        }
    }

    /// Guards that the time left counts down at a steady pace, and takes seconds to follow when half of the work is
    /// gone at once.
    #[test]
    fn the_time_left_does_not_jump() {
        let mut end = End::default();
        let (mut before, mut largest) = (None, 0.0_f64);
        for tick in 1..=400_u64 {
            // 100 units a second, of 20,000 that become 8,000 after 20 s.
            let (now_s, done) = (0.2 * tick as f64, 20 * tick);
            let left_s = end.left_s(now_s, done, if tick < 100 { 20_000 } else { 8_000 });
            if tick == 99 {
                assert!((left_s - 180.2).abs() < 0.1, "{left_s}");
            }
            largest = largest.max(before.map_or(0.0, |before: f64| (left_s - before).abs()));
            before = Some(left_s);
        }
        assert!(largest < 3.0, "{largest} s between two updates");
        assert_eq!(before, Some(0.0), "all work is done");
    }
}
