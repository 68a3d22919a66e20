//! Puts a session's records in the order of their numbers, and requests missing ones.

use std::collections::BTreeMap;
use std::time::Duration;

use fiatlux_proto::limits::{MAX_TRUTHS_PER_REQUEST, RECORDING_WINDOW};
use fiatlux_proto::v3::{StepRecord, StepRecordRequest};

/// Most records of a session that wait for an earlier one. Further ones are dropped, and requested again later.
pub const MAX_WAITING: usize = 1024;

/// After this time without a record, the session is asked whether there are more.
const QUIET: Duration = Duration::from_secs(1);

/// A session that never sent a record is asked less and less often, down to this interval: anybody can announce a session.
const SILENT: Duration = Duration::from_secs(5);

/// Time between two requests for the same record.
const AGAIN: Duration = Duration::from_millis(200);

/// A record that is missing from this many replies is lost, if the server has had to forget it.
const TRIES: u32 = 3;

/// The same, if the server should still have the record: the request or its reply may have been lost.
const TRIES_IN_WINDOW: u32 = 15;

/// Requests in which a recorder that resumes a bag searches for the first record that the server has.
const MAX_PROBES: u64 = 4096;

/// The next part of a session's sequence of records.
#[derive(Debug, PartialEq)]
pub(super) enum Next {
    /// The next record of the session.
    StepRecord(Box<StepRecord>),
    /// Records that are lost for good.
    Lost {
        /// Number of the first lost record.
        from: u64,
        /// Number of the first record after them.
        to: u64,
    },
}

/// The records of one session.
#[derive(Debug)]
pub(super) struct Order {
    next: u64,
    /// The number of the next record is not known yet; it is searched in steps of one request.
    searching: Option<u64>,
    waiting: BTreeMap<u64, StepRecord>,
    /// The request that is under way.
    asked: Option<StepRecordRequest>,
    /// The last request brought records: what is published may be lost on the way.
    is_pulled: bool,
    /// Nothing is requested before this time.
    ask_at: Duration,
    heard_at: Duration,
    since: Duration,
    /// A record has come, in order or not.
    is_heard: bool,
    tries: u32,
    lost: Option<(u64, u64)>,
    /// No record was given out yet.
    is_fresh: bool,
}

impl Order {
    /// Starts at the first record; for a resumed bag, at the first one that the server still has.
    pub fn new(takes_up: bool, now: Duration) -> Self {
        Self {
            next: 0,
            searching: takes_up.then_some(0),
            waiting: BTreeMap::new(),
            asked: None,
            is_pulled: false,
            ask_at: now,
            heard_at: now,
            since: now,
            is_heard: false,
            tries: 0,
            lost: None,
            is_fresh: true,
        }
    }

    /// Number of the next record.
    pub fn next_seq(&self) -> u64 {
        self.next
    }

    /// Accepts a record, in any order and any number of times.
    pub fn take(&mut self, record: StepRecord, now: Duration) {
        self.heard_at = now;
        self.is_heard = true;
        let seq = record.seq;
        let is_old = seq < self.next && self.searching.is_none();
        if is_old || self.waiting.contains_key(&seq) {
            return;
        }
        if self.waiting.len() >= MAX_WAITING {
            // Earlier records are needed first.
            match self.waiting.last_key_value() {
                Some((last, _)) if *last > seq => self.waiting.pop_last(),
                _ => return,
            };
        }
        self.waiting.insert(seq, record);
    }

    /// The next record, or a gap that cannot be filled; `None` while it has to wait.
    pub fn next(&mut self) -> Option<Next> {
        if self.searching.is_some() {
            return None;
        }
        if let Some((from, to)) = self.lost.take() {
            self.next = to;
            self.waiting = self.waiting.split_off(&to);
            return Some(Next::Lost { from, to });
        }
        let record = self.waiting.remove(&self.next)?;
        self.next += 1;
        self.tries = 0;
        self.is_fresh = false;
        Some(Next::StepRecord(Box::new(record)))
    }

    /// The request to send now. There is no other until [`Order::answered`] is called.
    pub fn request(&mut self, now: Duration) -> Option<StepRecordRequest> {
        if self.asked.is_some() || now < self.ask_at {
            return None;
        }
        let request = match (self.searching, self.waiting.keys().next()) {
            (Some(from_seq), _) => StepRecordRequest { from_seq, count: MAX_TRUTHS_PER_REQUEST },
            (None, Some(first)) if *first > self.next => {
                StepRecordRequest { from_seq: self.next, count: (first - self.next).min(MAX_TRUTHS_PER_REQUEST) }
            }
            (None, None) if now >= self.heard_at + self.quiet() => {
                StepRecordRequest { from_seq: self.next, count: MAX_TRUTHS_PER_REQUEST }
            }
            (None, _) => return None,
        };
        self.asked = Some(request);
        Some(request)
    }

    /// When there may be something to request, if no record comes before.
    pub fn wake_at(&self) -> Option<Duration> {
        let is_idle = self.searching.is_none() && self.waiting.is_empty();
        let quiet = if is_idle { self.heard_at + self.quiet() } else { self.ask_at };
        self.asked.is_none().then(|| quiet.max(self.ask_at))
    }

    /// Time to the next message to the session: the usual interval, or longer and longer ones as long as no record has come.
    pub fn pace(&self, usual: Duration, now: Duration) -> Duration {
        if self.is_heard { usual } else { now.saturating_sub(self.since).clamp(usual, SILENT) }
    }

    /// Time without a record after which the session is asked. Where the last request brought some, others were not received when
    /// they were published.
    fn quiet(&self) -> Duration {
        if self.is_pulled { AGAIN } else { self.pace(QUIET, self.heard_at) }
    }

    /// The reply to the request is complete, and its records were given to [`Order::take`].
    pub fn answered(&mut self, now: Duration) {
        let Some(StepRecordRequest { from_seq: from, count }) = self.asked.take() else { return };
        let first = self.waiting.keys().next().copied();
        if self.searching.is_some() {
            return self.search_on(from, first, now);
        }
        self.is_pulled = self.next > from;
        if self.next.saturating_sub(from) >= count.min(MAX_TRUTHS_PER_REQUEST) && self.waiting.is_empty() {
            // The reply was full: there may be more.
            (self.ask_at, self.heard_at) = (now, now.saturating_sub(QUIET));
            return;
        }
        // A missing record may be under way, or not made yet.
        self.ask_at = now + AGAIN;
        self.heard_at = now;
        let (Some(first), Some((newest, _))) = (first, self.waiting.last_key_value()) else { return };
        if from != self.next || first <= self.next {
            self.ask_at = now;
            return;
        }
        self.tries += 1;
        // The server keeps only its window before the record that it sends.
        let window = newest.saturating_sub(RECORDING_WINDOW);
        let is_in_window = window <= self.next;
        if self.tries >= if is_in_window { TRIES_IN_WINDOW } else { TRIES } {
            self.tries = 0;
            // A late recorder starts where the server does: rows continue to be forgotten while it searches.
            let starts = is_in_window || self.is_fresh && self.is_answer(first);
            self.lost = Some((self.next, if starts { first } else { window.min(first) }));
        }
    }

    /// True if the records waiting from there on are a reply of the server, and not single rows that were sent just now.
    fn is_answer(&self, first: u64) -> bool {
        let in_a_row = self.waiting.keys().zip(first..).take_while(|(seq, expected)| *seq == expected).count();
        in_a_row as u64 >= MAX_TRUTHS_PER_REQUEST / 2 || in_a_row > 1 && in_a_row == self.waiting.len()
    }

    /// Number of records that have come but cannot be given out yet.
    pub fn waiting(&self) -> usize {
        self.waiting.len()
    }

    /// Consecutive requests of one length reach the first record that the server has before any other.
    fn search_on(&mut self, from: u64, first: Option<u64>, now: Duration) {
        let after = from.saturating_add(MAX_TRUTHS_PER_REQUEST);
        match first {
            Some(first) if first < after => {
                self.next = first;
                self.searching = None;
            }
            // This one was sent just now: the window is before it.
            Some(first) => self.searching = Some(after.max(first.saturating_sub(RECORDING_WINDOW))),
            None if after < MAX_PROBES * MAX_TRUTHS_PER_REQUEST => self.searching = Some(after),
            None => {
                self.searching = Some(0);
                self.ask_at = now + QUIET;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NOW: Duration = Duration::from_secs(100);

    fn record(seq: u64) -> StepRecord {
        StepRecord { seq, ..StepRecord::default() }
    }

    fn seqs(order: &mut Order) -> Vec<u64> {
        std::iter::from_fn(|| match order.next() {
            Some(Next::StepRecord(record)) => Some(record.seq),
            _ => None,
        })
        .collect()
    }

    #[test]
    fn any_order_and_any_number_of_times() {
        let mut order = Order::new(false, NOW);
        for seq in [2, 0, 0, 2] {
            order.take(record(seq), NOW);
        }
        assert_eq!(seqs(&mut order), [0]);
        for seq in [0, 1, 3, 1] {
            order.take(record(seq), NOW);
        }
        assert_eq!(seqs(&mut order), [1, 2, 3]);
        assert_eq!(order.next_seq(), 4);
        assert_eq!(order.request(NOW), None, "nothing is missing");
    }

    #[test]
    fn gaps_are_asked_for_one_request_at_a_time() {
        let mut order = Order::new(false, NOW);
        order.take(record(5), NOW);
        assert_eq!(order.request(NOW), Some(StepRecordRequest { from_seq: 0, count: 5 }));
        assert_eq!(order.request(NOW), None, "one is under way");
        (0..5).for_each(|seq| order.take(record(seq), NOW));
        order.answered(NOW);
        assert_eq!(seqs(&mut order), [0, 1, 2, 3, 4, 5]);
        order.take(record(1000), NOW);
        let later = NOW + AGAIN;
        assert_eq!(order.request(later), Some(StepRecordRequest { from_seq: 6, count: MAX_TRUTHS_PER_REQUEST }));
    }

    /// Guards a session whose published records are all lost, such as by a flood on its key: full replies follow one another at
    /// once, and one that was not full is followed by the next request soon.
    #[test]
    fn without_publications_replies_alone_keep_up() {
        let mut order = Order::new(false, NOW);
        let mut now = NOW + QUIET;
        for part in 0..3 {
            let from_seq = part * MAX_TRUTHS_PER_REQUEST;
            let request = StepRecordRequest { from_seq, count: MAX_TRUTHS_PER_REQUEST };
            assert_eq!(order.request(now), Some(request), "part {part}");
            (from_seq..from_seq + MAX_TRUTHS_PER_REQUEST).for_each(|seq| order.take(record(seq), now));
            assert_eq!(seqs(&mut order).len() as u64, MAX_TRUTHS_PER_REQUEST);
            order.answered(now);
        }
        assert!(order.request(now).is_some());
        order.take(record(3 * MAX_TRUTHS_PER_REQUEST), now);
        seqs(&mut order);
        order.answered(now);
        assert_eq!(order.request(now), None);
        now += AGAIN;
        assert!(order.request(now).is_some());
        order.answered(now);
        assert_eq!((order.request(now + AGAIN), order.request(now + QUIET).is_some()), (None, true), "it was empty");
    }

    #[test]
    fn silence_is_asked_about() {
        let mut order = Order::new(false, NOW);
        assert_eq!(order.request(NOW), None);
        let later = NOW + QUIET;
        assert_eq!(order.request(later), Some(StepRecordRequest { from_seq: 0, count: MAX_TRUTHS_PER_REQUEST }));
        order.answered(later);
        assert_eq!(order.request(later + AGAIN), None, "and then not again at once");
        assert!(order.request(later + QUIET).is_some());
    }

    #[test]
    fn what_nobody_has_is_lost() {
        let mut order = Order::new(false, NOW);
        order.take(record(0), NOW);
        assert_eq!(seqs(&mut order), [0]);
        order.take(record(2000), NOW);
        let mut now = NOW;
        for _ in 0..TRIES {
            assert_eq!(order.next(), None);
            assert!(order.request(now).is_some());
            order.answered(now);
            now += AGAIN;
        }
        // Requests what the window may still hold.
        assert_eq!(order.next(), Some(Next::Lost { from: 1, to: 2000 - RECORDING_WINDOW }));
        assert_eq!(order.request(now).map(|request| request.from_seq), Some(2000 - RECORDING_WINDOW));
        (1990..2000).for_each(|seq| order.take(record(seq), now));
        order.answered(now);
        for _ in 1..TRIES_IN_WINDOW {
            assert_eq!(order.next(), None, "the server should have it");
            now += AGAIN;
            assert!(order.request(now).is_some());
            order.answered(now);
        }
        assert_eq!(order.next(), Some(Next::Lost { from: 1488, to: 1990 }));
    }

    /// Guards that a late recorder begins with the first record that the server has, before more of them are forgotten.
    #[test]
    fn a_late_start_begins_where_the_server_does() {
        for kept in [600..1112, 600..612] {
            let mut order = Order::new(false, NOW);
            order.take(record(kept.end - 1), NOW);
            let mut now = NOW;
            let mut questions = 0;
            let found = loop {
                if let Some(next) = order.next() {
                    break next;
                }
                let request = order.request(now).expect("it asks");
                // Answers like the server: from the first one that it has.
                let from = request.from_seq.max(kept.start);
                (from..kept.end).take(request.count as usize).for_each(|seq| order.take(record(seq), now));
                order.answered(now);
                (now, questions) = (now + AGAIN, questions + 1);
            };
            assert_eq!((found, questions), (Next::Lost { from: 0, to: 600 }, TRIES));
            assert_eq!(seqs(&mut order).first(), Some(&600));
        }
    }

    #[test]
    fn memory_is_bounded_and_the_earlier_stay() {
        let mut order = Order::new(false, NOW);
        (1..5000).rev().for_each(|seq| order.take(record(seq), NOW));
        assert_eq!(order.waiting.len(), MAX_WAITING);
        order.take(record(0), NOW);
        assert_eq!(seqs(&mut order).len(), MAX_WAITING);
    }

    /// Guards that a recorder that comes back finds the window wherever it is, even if nothing new is sent.
    #[test]
    fn a_search_finds_the_first_record() {
        for window in [0..1, 100..612, 4000..4512, 10_000..10_001] {
            for is_heard in [false, true] {
                let mut order = Order::new(true, NOW);
                if is_heard {
                    order.take(record(window.end - 1), NOW);
                }
                while let Some(request) = order.request(NOW) {
                    // Answers like the server.
                    let asked = request.from_seq..request.from_seq + request.count;
                    window.clone().filter(|seq| asked.contains(seq)).for_each(|seq| order.take(record(seq), NOW));
                    order.answered(NOW);
                }
                assert_eq!(seqs(&mut order).first(), Some(&window.start), "{window:?}");
            }
        }
    }
}
