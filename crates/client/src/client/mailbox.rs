//! Messages from the carrier's threads on their way to the client's thread.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use fiatlux_carrier::BusyWait;
use fiatlux_session::client::Input;

/// Largest number of waiting messages; the oldest are dropped first, since the newest matter.
const CAPACITY: usize = 64;

/// A bounded queue between threads.
#[derive(Debug, Default)]
pub struct Mailbox {
    queue: Mutex<VecDeque<Input>>,
    /// A message waits; can be read without the lock.
    has_mail: AtomicBool,
    filled: Condvar,
}

impl Mailbox {
    pub fn put(&self, input: Input) {
        let mut queue = self.lock();
        if queue.len() >= CAPACITY {
            // The end of a query is reported only once.
            let old = queue.iter().position(|input| matches!(input, Input::Observation(_) | Input::Notice(_)));
            queue.remove(old.unwrap_or(0));
        }
        queue.push_back(input);
        self.has_mail.store(true, Ordering::Release);
        drop(queue);
        self.filled.notify_one();
    }

    pub fn take(&self) -> Option<Input> {
        let mut queue = self.lock();
        self.has_mail.store(queue.len() > 1, Ordering::Release);
        queue.pop_front()
    }

    /// Waits for a message, for at most `longest`; polls first if it is given a busy wait.
    pub fn wait(&self, longest: Duration, busy: Option<&mut BusyWait>) {
        let has_mail = || self.has_mail.load(Ordering::Acquire);
        if longest.is_zero() || busy.is_some_and(|busy| busy.until(has_mail)) {
            return;
        }
        let queue = self.lock();
        // The caller checks whether there is mail.
        drop(self.filled.wait_timeout_while(queue, longest, |queue| queue.is_empty()));
    }

    fn lock(&self) -> MutexGuard<'_, VecDeque<Input>> {
        // The queue is intact even if a thread panicked while holding the lock.
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_newest_stay_and_answers_are_never_lost() {
        let mailbox = Mailbox::default();
        mailbox.put(Input::Reset(None));
        (0..=255).for_each(|i| mailbox.put(Input::Observation(vec![i].into())));
        assert!(matches!(mailbox.take(), Some(Input::Reset(None))));
        let rest: Vec<u8> = std::iter::from_fn(|| mailbox.take())
            .flat_map(|input| if let Input::Observation(bytes) = input { bytes.to_vec() } else { vec![] })
            .collect();
        assert_eq!(rest, (193..=255).collect::<Vec<_>>());
    }
}
