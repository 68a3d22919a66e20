//! The threads of a batch. Each begins with worlds of its own, whose memory its core knows, and then takes those that others
//! have not come to, so that no core waits for a slower one. Threads sleep between calls.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, AtomicU8, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, RwLock};
use std::thread::{JoinHandle, Thread};

use crate::BatchError;
use crate::job::{Job, Order, Worker};

/// Times that a thread with nothing to do yields before it sleeps, so that it need not be woken between two steps that follow
/// each other at once.
const YIELDS: usize = 500;

/// Who may use a job: the caller, the first thread that takes it, or the thread that took it.
const CALLER: u8 = 0;
const DUE: u8 = 1;
const TAKEN: u8 = 2;

/// In place of a number of calls: the threads must end.
const OVER: usize = usize::MAX;

/// Shared by the threads.
struct Board {
    /// One for each world. The locks are never contended: [`Board::turns`] says who may use a job.
    jobs: Vec<Mutex<Job>>,
    turns: Vec<AtomicU8>,
    /// The order of all jobs that are due, and the actions of all worlds. Threads read them by themselves, since giving them out
    /// takes time in which none works. A thread holds this as long as it looks for jobs.
    call: RwLock<(Order, Vec<f64>)>,
    /// Number of calls so far. A thread that has seen fewer looks for jobs.
    calls: AtomicUsize,
    /// Number of threads that have begun.
    begun: AtomicUsize,
    /// Jobs that are still due must not be done.
    stop: AtomicBool,
    /// Whom to wake when there is nothing left to take.
    caller: Mutex<Thread>,
}

/// A panic is caught before it can leave anything half-way; nothing poisons a lock.
fn lock<T>(held: &Mutex<T>) -> MutexGuard<'_, T> {
    held.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Waits until something holds of which another thread makes sure before it wakes this one.
fn wait(until: impl Fn() -> bool) {
    let mut yields = 0..YIELDS;
    while !until() {
        match yields.next() {
            Some(_) => std::thread::yield_now(),
            None => std::thread::park(),
        }
    }
}

impl Board {
    /// Does the jobs that are due, those of its own worlds first; of others, those that their thread would come to last.
    /// `ask` is called before each.
    fn work(&self, worker: &mut Worker, ask: &mut dyn FnMut()) {
        let call = self.call.read().unwrap_or_else(PoisonError::into_inner);
        let (order, actions) = &*call;
        let each = actions.len() / self.jobs.len();
        let (own, reach) = (worker.own.clone(), worker.reach.clone());
        let others = (reach.start..own.start).rev().chain((own.end..reach.end).rev());
        for world in own.chain(others) {
            let turn = &self.turns[world];
            if turn.load(Ordering::Relaxed) != DUE {
                continue;
            }
            ask();
            if turn.compare_exchange(DUE, TAKEN, Ordering::Acquire, Ordering::Relaxed).is_err() {
                continue;
            }
            let mut job = lock(&self.jobs[world]);
            job.error = if self.stop.load(Ordering::Relaxed) {
                Some(BatchError::Stopped)
            } else {
                let done =
                    catch_unwind(AssertUnwindSafe(|| worker.run(&mut job, order, &actions[world * each..][..each])));
                done.unwrap_or(Err(BatchError::Panicked { world })).err()
            };
            drop(job);
            turn.store(CALLER, Ordering::Release);
        }
    }

    /// The loop of a thread.
    fn serve(&self, worker: &mut Worker) {
        self.begun.fetch_add(1, Ordering::Release);
        let mut seen = 0;
        loop {
            lock(&self.caller).unpark();
            wait(|| self.calls.load(Ordering::Relaxed) != seen);
            seen = self.calls.load(Ordering::Acquire);
            if seen == OVER {
                return;
            }
            self.work(worker, &mut || ());
        }
    }
}

/// All worlds of a batch and the threads that step them, the caller's among them.
pub(crate) struct Workers {
    board: Arc<Board>,
    /// Of the caller's thread.
    worker: Worker,
    threads: Vec<JoinHandle<()>>,
    /// The process that has the threads.
    process: u32,
}

impl Workers {
    /// `worker` makes what belongs to a thread, by its number; 0 is the caller's. Each thread makes its own, so that its memory is
    /// near its core and shares no cache line with that of another.
    pub fn new(
        jobs: Vec<Job>,
        threads: usize,
        worker: impl Fn(usize) -> Worker + Send + Sync + 'static,
    ) -> Result<Self, BatchError> {
        let board = Arc::new(Board {
            turns: jobs.iter().map(|_| AtomicU8::new(CALLER)).collect(),
            jobs: jobs.into_iter().map(Mutex::new).collect(),
            call: RwLock::new((Order::Reset, Vec::new())),
            calls: AtomicUsize::new(0),
            begun: AtomicUsize::new(0),
            stop: AtomicBool::new(false),
            caller: Mutex::new(std::thread::current()),
        });
        let worker = Arc::new(worker);
        let mut workers = Self { board, worker: worker(0), threads: Vec::new(), process: std::process::id() };
        for number in 1..threads {
            let (board, worker) = (Arc::clone(&workers.board), Arc::clone(&worker));
            let thread = std::thread::Builder::new().name("fiatlux-batch".into());
            let serve = move || board.serve(&mut worker(number));
            workers.threads.push(thread.spawn(serve).map_err(BatchError::Thread)?);
        }
        // To begin takes memory, of which a step takes none.
        wait(|| workers.board.begun.load(Ordering::Acquire) == workers.threads.len());
        Ok(workers)
    }

    /// Number of threads, including the caller's.
    pub fn len(&self) -> usize {
        self.threads.len() + 1
    }

    /// Refuses a forked child of the process that started the threads, which does not have them.
    pub fn check_process(&self) -> Result<(), BatchError> {
        let is_complete = self.threads.is_empty() || self.process == std::process::id();
        if is_complete { Ok(()) } else { Err(BatchError::Forked { parent: self.process }) }
    }

    /// Lets the threads carry out an order in all worlds, with the actions of all of them if it takes any, and shows the jobs in order
    /// to `finish`. The caller's thread asks before each job that it takes or finishes whether to continue; if not, no further one is
    /// done. Returns whether all went on.
    pub fn run(
        &mut self,
        order: &Order,
        actions: &[f64],
        may_go_on: &mut dyn FnMut() -> bool,
        mut finish: impl FnMut(&mut Job),
    ) -> bool {
        let board = &*self.board;
        board.stop.store(false, Ordering::Relaxed);
        *lock(&board.caller) = std::thread::current();
        {
            let mut call = board.call.write().unwrap_or_else(PoisonError::into_inner);
            call.0.clone_from(order);
            call.1.clear();
            call.1.extend_from_slice(actions);
        }
        board.turns.iter().for_each(|turn| turn.store(DUE, Ordering::Release));
        self.announce(board.calls.load(Ordering::Relaxed) + 1);
        let mut ask = || {
            let is_stopped = board.stop.load(Ordering::Relaxed);
            if !is_stopped && !catch_unwind(AssertUnwindSafe(&mut *may_go_on)).unwrap_or(false) {
                board.stop.store(true, Ordering::Relaxed);
            }
        };
        board.work(&mut self.worker, &mut ask);
        for (job, turn) in board.jobs.iter().zip(&board.turns) {
            ask();
            wait(|| turn.load(Ordering::Acquire) == CALLER);
            finish(&mut lock(job));
        }
        !board.stop.load(Ordering::Relaxed)
    }

    /// Sets the number of calls, and wakes the threads that sleep.
    fn announce(&self, calls: usize) {
        self.board.calls.store(calls, Ordering::Release);
        self.threads.iter().for_each(|thread| thread.thread().unpark());
    }

    /// The job of a world, between calls.
    pub fn job(&self, world: usize) -> Option<MutexGuard<'_, Job>> {
        self.board.jobs.get(world).map(lock)
    }

    /// All jobs, between calls.
    pub fn jobs(&self) -> impl Iterator<Item = MutexGuard<'_, Job>> {
        self.board.jobs.iter().map(lock)
    }
}

impl Drop for Workers {
    fn drop(&mut self) {
        if self.check_process().is_err() {
            // The threads do not exist here, and one of them may hold a lock: leave everything as it is.
            std::mem::forget(Arc::clone(&self.board));
            std::mem::forget(std::mem::take(&mut self.threads));
            return;
        }
        self.announce(OVER);
        for thread in self.threads.drain(..) {
            // It has caught every panic of a task; nothing is left to report.
            let _ = thread.join();
        }
    }
}
