//! Which truth goes into which bag, and which bags are cut.

use std::collections::VecDeque;
use std::time::Duration;

use fiatlux_proto::v3::{EpisodeHeader, EpisodeResult, StepRecord, StepRecordRequest};

use super::order::{Next, Order};

/// What is to be written, in this order.
#[derive(Debug, PartialEq)]
pub(super) enum Write {
    /// A new bag.
    Open(Box<EpisodeHeader>),
    /// A row, or the events that end an episode without one.
    Row(Box<StepRecord>),
    /// The bag is whole.
    Finish(Box<EpisodeResult>),
    /// The bag ends before its episode.
    Cut(String),
}

/// A bag that is open.
#[derive(Debug, Clone, Copy)]
struct Open {
    episode: u64,
    /// The row that comes next.
    next_step: u64,
}

/// One session's truths on their way into bags.
#[derive(Debug)]
pub(super) struct Track {
    order: Order,
    open: Option<Open>,
    /// Header of a bag that was taken up.
    taken_up: Option<EpisodeHeader>,
    /// Number that row 0 of the open bag's episode has or would have.
    first_seq: Option<u64>,
    writes: VecDeque<Write>,
}

impl Track {
    /// A session of which nothing is on disk.
    pub fn new(now: Duration) -> Self {
        let order = Order::new(false, now);
        Self { order, open: None, taken_up: None, first_seq: None, writes: VecDeque::new() }
    }

    /// A session with an open bag of that header that has the rows before `next_step`.
    pub fn resume(header: EpisodeHeader, next_step: u64, now: Duration) -> Self {
        let open = Some(Open { episode: header.episode, next_step });
        let order = Order::new(true, now);
        Self { order, open, taken_up: Some(header), first_seq: None, writes: VecDeque::new() }
    }

    /// Takes a truth in, in whatever order.
    pub fn take(&mut self, truth: StepRecord, now: Duration) {
        self.order.take(truth, now);
    }

    /// What to ask the server for now.
    pub fn request(&mut self, now: Duration) -> Option<StepRecordRequest> {
        self.order.request(now)
    }

    /// The answer is complete.
    pub fn answered(&mut self, now: Duration) {
        self.order.answered(now);
    }

    /// A bag is open.
    pub fn has_open_bag(&self) -> bool {
        self.open.is_some()
    }

    /// The open bag cannot be written; what follows of its episode is passed over.
    pub fn give_up(&mut self) {
        self.open = None;
        self.writes.clear();
    }

    /// Number of the first truth that is not on disk, when the open bag has the rows before `next_step` there.
    pub fn next_seq(&self, next_step: u64) -> u64 {
        match (self.open, self.first_seq) {
            (None, _) => self.order.next_seq(),
            (Some(_), Some(first)) => first.saturating_add(next_step).min(self.order.next_seq()),
            // Taken up, and nothing came yet.
            (Some(_), None) => 0,
        }
    }

    /// The next thing to write.
    pub fn next_write(&mut self) -> Option<Write> {
        loop {
            if let Some(write) = self.writes.pop_front() {
                return Some(write);
            }
            match self.order.next()? {
                Next::StepRecord(truth) => self.truth(truth),
                Next::Lost { from, to } => {
                    let lost = to - from;
                    self.cut(&format!("{lost} rows were lost: the recorder was away, or too slow, for too long"));
                }
            }
        }
    }

    fn cut(&mut self, reason: &str) {
        if self.open.take().is_some() {
            self.writes.push_back(Write::Cut(reason.into()));
        }
    }

    fn truth(&mut self, mut truth: Box<StepRecord>) {
        let begins = truth.step == 0 && truth.header.is_some();
        let goes_on = self.open.is_some_and(|open| open.episode == truth.episode);
        // A first row belongs to an open bag only where that was left before the server knew that it was on disk.
        if !goes_on || begins && truth.header != self.taken_up {
            self.cut("the session went on to another episode");
            // Only its first row opens a bag; what follows a cut is passed over.
            let (true, Some(header)) = (begins, truth.header.take()) else { return };
            self.open = Some(Open { episode: truth.episode, next_step: 0 });
            self.writes.push_back(Write::Open(Box::new(header)));
        }
        self.taken_up = None;
        let Some(open) = &mut self.open else { return };
        let is_row = !truth.state.is_empty();
        // A truth without a row follows the last one of its episode.
        let place = if is_row { truth.step } else { truth.step.saturating_add(1) };
        self.first_seq = Some(truth.seq.saturating_sub(place));
        if place > open.next_step {
            let (next, step) = (open.next_step, truth.step);
            return self.cut(&format!("row {step} came after row {}", next.saturating_sub(1)));
        }
        if is_row && place < open.next_step {
            // On disk already.
            return;
        }
        open.next_step += u64::from(is_row);
        let result = truth.result.take();
        self.writes.push_back(Write::Row(truth));
        if let Some(result) = result {
            self.open = None;
            self.first_seq = None;
            self.writes.push_back(Write::Finish(Box::new(result)));
        }
    }
}

#[cfg(test)]
mod tests;
