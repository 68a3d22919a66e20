//! Searches in slices: a bounded amount of work at a time, such as one slice in each control step.
//!
//! A search is an `async` function that pays for what it does with [`Work::spend`] and stops there once the slice is used up.
//! Work is counted, not timed, so that a search stops at the same places on every machine.
//!
//! ```
//! use fiatlux_kinematics::{Search, Work};
//!
//! async fn sum(upto: u64, work: Work) -> u64 {
//!     let mut sum = 0;
//!     for number in 1..=upto {
//!         sum += number;
//!         work.spend(1).await;
//!     }
//!     sum
//! }
//!
//! let mut search = Search::new(|work| sum(10, work));
//! assert_eq!(search.go_on(4), None);
//! assert_eq!(search.go_on(4), None);
//! assert_eq!(search.go_on(4), Some(55));
//! ```

use std::fmt;
use std::future::Future;
use std::pin::{Pin, pin};
use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};
use std::task::{Context, Poll, Waker};

/// The rest of a slice, in units of work. A unit is about the work of looking at one pair of shapes: a tenth of a microsecond.
#[derive(Debug, Clone, Default)]
pub struct Work {
    /// Below 0 a search stands still; `None` for one that is not sliced.
    left: Option<Arc<AtomicI64>>,
}

impl Work {
    /// A search that never stops before its end.
    pub fn unlimited() -> Self {
        Self { left: None }
    }

    /// Pays for work that was done. Where the slice does not have as much, the search stands still until later slices have paid
    /// for the rest.
    pub fn spend(&self, units: usize) -> impl Future<Output = ()> + Send + '_ {
        if let Some(left) = &self.left {
            left.fetch_sub(i64::from(u32::try_from(units).unwrap_or(u32::MAX)), Ordering::Relaxed);
        }
        Paid(self)
    }
}

struct Paid<'a>(&'a Work);

impl Future for Paid<'_> {
    type Output = ();

    fn poll(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<()> {
        let is_paid = self.0.left.as_ref().is_none_or(|left| left.load(Ordering::Relaxed) >= 0);
        if is_paid { Poll::Ready(()) } else { Poll::Pending }
    }
}

/// A search under way.
pub struct Search<T> {
    /// `None` once it has ended.
    future: Option<Pin<Box<dyn Future<Output = T> + Send>>>,
    left: Arc<AtomicI64>,
}

impl<T> Search<T> {
    /// A search that waits for its first slice. It may await nothing but [`Work::spend`].
    pub fn new<F: Future<Output = T> + Send + 'static>(search: impl FnOnce(Work) -> F) -> Self {
        let left = Arc::new(AtomicI64::new(0));
        let work = Work { left: Some(Arc::clone(&left)) };
        Self { future: Some(Box::pin(search(work))), left }
    }

    /// Goes on for a slice; its result once it has come to its end, and `None` before and after that.
    pub fn go_on(&mut self, units: u32) -> Option<T> {
        let future = self.future.as_mut()?;
        // What the last slice overdrew is taken from this one.
        self.left.fetch_add(i64::from(units), Ordering::Relaxed);
        if self.left.load(Ordering::Relaxed) < 0 {
            return None;
        }
        let Poll::Ready(found) = future.as_mut().poll(&mut Context::from_waker(Waker::noop())) else { return None };
        self.future = None;
        Some(found)
    }
}

impl<T> fmt::Debug for Search<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let left = self.left.load(Ordering::Relaxed);
        f.debug_struct("Search").field("has_ended", &self.future.is_none()).field("left", &left).finish()
    }
}

/// Makes a search that has [`Work::unlimited`] from its beginning to its end.
pub fn at_once<T>(search: impl Future<Output = T>) -> T {
    let mut search = pin!(search);
    let mut context = Context::from_waker(Waker::noop());
    loop {
        if let Poll::Ready(found) = search.as_mut().poll(&mut context) {
            return found;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    async fn places(work: Work, costs: &'static [usize]) -> usize {
        for cost in costs {
            work.spend(*cost).await;
        }
        costs.len()
    }

    /// Work beyond a slice is missing in the next ones, so that the average is bounded.
    #[test]
    fn a_large_piece_of_work_takes_several_slices() {
        let mut search = Search::new(|work| places(work, &[25, 5]));
        let slices = (1..).find(|_| search.go_on(10).is_some());
        assert_eq!(slices, Some(3));
        assert_eq!(search.go_on(10), None, "it has ended");
    }

    #[test]
    fn a_search_without_slices_ends_at_once() {
        assert_eq!(at_once(places(Work::unlimited(), &[usize::MAX, 1])), 2);
    }
}
