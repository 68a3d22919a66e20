//! The threads of a batch. Each keeps its worlds, so that the split depends on nothing; threads sleep between calls.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;

use crate::BatchError;
use crate::shard::Shard;

/// Who may use a shard.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Turn {
    Caller,
    Worker,
    /// The thread must end.
    Over,
}

struct Seat {
    held: Mutex<(Turn, Shard)>,
    turn: Condvar,
}

impl Seat {
    fn lock(&self) -> MutexGuard<'_, (Turn, Shard)> {
        // A panic is caught before it can leave a shard half-way; nothing poisons the lock.
        self.held.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn wait(&self, until: impl Fn(Turn) -> bool) -> MutexGuard<'_, (Turn, Shard)> {
        let waited = self.turn.wait_while(self.lock(), |(turn, _)| !until(*turn));
        waited.unwrap_or_else(PoisonError::into_inner)
    }

    fn give(&self, turn: Turn) {
        self.lock().0 = turn;
        self.turn.notify_all();
    }

    /// The loop of a thread.
    fn serve(&self, stop: &AtomicBool) {
        loop {
            let mut held = self.wait(|turn| turn != Turn::Caller);
            if held.0 == Turn::Over {
                return;
            }
            run(&mut held.1, || !stop.load(Ordering::Relaxed));
            held.0 = Turn::Caller;
            drop(held);
            self.turn.notify_all();
        }
    }
}

/// Carries out a shard's order; a panic of the task becomes an error.
fn run(shard: &mut Shard, may_go_on: impl FnMut() -> bool) {
    if catch_unwind(AssertUnwindSafe(|| shard.run(may_go_on))).is_err() {
        shard.error = Some(BatchError::Panicked { first: shard.first });
    }
}

/// All shards of a batch. The caller's thread steps the worlds of the first one.
pub(crate) struct Workers {
    seats: Vec<Arc<Seat>>,
    stop: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
    /// The process that has the threads.
    process: u32,
}

impl Workers {
    pub fn new(shards: Vec<Shard>) -> Result<Self, BatchError> {
        let seat = |shard| Arc::new(Seat { held: Mutex::new((Turn::Caller, shard)), turn: Condvar::new() });
        let seats = shards.into_iter().map(seat).collect();
        let mut workers = Self { seats, stop: Arc::default(), threads: Vec::new(), process: std::process::id() };
        for seat in &workers.seats[1..] {
            let (seat, stop) = (Arc::clone(seat), Arc::clone(&workers.stop));
            let thread = std::thread::Builder::new().name("fiatlux-batch".into());
            workers.threads.push(thread.spawn(move || seat.serve(&stop)).map_err(BatchError::Thread)?);
        }
        Ok(workers)
    }

    /// Number of threads, including the caller's.
    pub fn len(&self) -> usize {
        self.seats.len()
    }

    /// Refuses a forked child of the process that started the threads, which does not have them.
    pub fn check_process(&self) -> Result<(), BatchError> {
        let is_complete = self.threads.is_empty() || self.process == std::process::id();
        if is_complete { Ok(()) } else { Err(BatchError::Forked { parent: self.process }) }
    }

    /// Shows each shard in turn to `prepare`, lets all of them carry out their orders at the same time, and shows them
    /// to `finish`. The caller's thread asks before each of its worlds whether to continue; if not, every thread stops.
    pub fn run(
        &mut self,
        mut prepare: impl FnMut(&mut Shard),
        may_go_on: &mut dyn FnMut() -> bool,
        mut finish: impl FnMut(&mut Shard),
    ) {
        self.stop.store(false, Ordering::Relaxed);
        let (own, others) = self.seats.split_at(1);
        for seat in others {
            prepare(&mut seat.lock().1);
            seat.give(Turn::Worker);
        }
        for seat in own {
            let shard = &mut seat.lock().1;
            prepare(shard);
            run(shard, || {
                let goes_on = may_go_on();
                if !goes_on {
                    self.stop.store(true, Ordering::Relaxed);
                }
                goes_on
            });
            finish(shard);
        }
        for seat in others {
            finish(&mut seat.wait(|turn| turn == Turn::Caller).1);
        }
    }

    /// Shows each shard in turn.
    pub fn each(&self, mut see: impl FnMut(&mut Shard)) {
        self.seats.iter().for_each(|seat| see(&mut seat.lock().1));
    }
}

impl Drop for Workers {
    fn drop(&mut self) {
        if self.check_process().is_err() {
            // A lock may be held by a thread that does not exist here: leave everything as it is.
            std::mem::forget(std::mem::take(&mut self.seats));
            std::mem::forget(std::mem::take(&mut self.threads));
            return;
        }
        self.seats.iter().for_each(|seat| seat.give(Turn::Over));
        for thread in self.threads.drain(..) {
            // It has caught every panic of a task; nothing is left to report.
            let _ = thread.join();
        }
    }
}
