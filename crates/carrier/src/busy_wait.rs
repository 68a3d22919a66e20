//! A short busy wait in front of a sleep.

use std::time::{Duration, Instant};

/// Maximum busy wait; if it pays, a control step and its round trip take less.
const SPAN: Duration = Duration::from_millis(1);

/// After failed waits, at most two to the power of this many waits sleep at once.
const MAX_SKIP_EXPONENT: u32 = 6;

/// Polls for up to a millisecond before the thread sleeps, as long as that pays. On a virtual machine waking a thread
/// costs 10 to 30 us, and waking an idle core costs more: a step in lockstep over TCP wakes six, one after another. If
/// polling fails, as with a slow policy or on a crowded machine, it becomes rarer: at least one in 64 waits.
#[derive(Debug, Default)]
pub struct BusyWait {
    in_vain: u32,
    skip: u32,
}

impl BusyWait {
    /// Polls until `is_ready`, and returns whether it is. The thread yields between polls.
    pub fn until(&mut self, is_ready: impl Fn() -> bool) -> bool {
        if self.skip > 0 {
            self.skip -= 1;
            return false;
        }
        let start = Instant::now();
        while start.elapsed() < SPAN {
            if is_ready() {
                self.in_vain = 0;
                return true;
            }
            std::thread::yield_now();
        }
        self.in_vain = (self.in_vain + 1).min(MAX_SKIP_EXPONENT);
        self.skip = (1 << self.in_vain) - 1;
        false
    }
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use super::*;

    #[test]
    fn looks_become_rare_where_they_are_in_vain() {
        let mut busy = BusyWait::default();
        let looks = Cell::new(0);
        let waits_with_a_look = |busy: &mut BusyWait, waits: usize| {
            let look = |_: &usize| {
                looks.set(0);
                busy.until(|| {
                    looks.set(looks.get() + 1);
                    false
                });
                looks.get() > 0
            };
            (0..waits).filter(look).count()
        };
        assert_eq!(waits_with_a_look(&mut busy, 1 + 2 + 4), 3);
        waits_with_a_look(&mut busy, 1000);
        assert_eq!(waits_with_a_look(&mut busy, 640), 10);
        // A successful poll makes polling frequent again.
        while !busy.until(|| true) {}
        assert!(busy.until(|| true) && busy.until(|| true));
    }
}
