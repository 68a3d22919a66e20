//! Counts what tests allocate. Whoever depends on it gets its allocator. One test a program: all threads share the counter.

use std::alloc::System;

use stats_alloc::{INSTRUMENTED_SYSTEM, Region, StatsAlloc};

#[global_allocator]
static ALLOCATOR: &StatsAlloc<System> = &INSTRUMENTED_SYSTEM;

/// Bytes that what `make` returns holds, without what it shares with others and had before.
pub fn held<T>(make: impl FnOnce() -> T) -> (T, usize) {
    let region = Region::new(ALLOCATOR);
    let made = make();
    let change = region.change();
    let bytes = change.bytes_allocated.saturating_sub(change.bytes_deallocated);
    (made, bytes)
}

/// Allocations and reallocations of `work` by all threads: the least of two runs, each from a new `start`, which is not counted.
///
/// Deterministic work allocates the same each time; the thread of the test harness allocates once, when it begins to wait.
pub fn count<T>(mut start: impl FnMut() -> T, mut work: impl FnMut(&mut T)) -> usize {
    let mut run = || {
        let mut state = start();
        let region = Region::new(ALLOCATOR);
        work(&mut state);
        let change = region.change();
        change.allocations + change.reallocations
    };
    run().min(run())
}
