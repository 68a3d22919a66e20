//! A recorder's side of a session: which record goes into which bag, which bags are cut, and what is acknowledged. It
//! follows the rules in `proto/PROTOCOL.md`.

mod order;
#[cfg(test)]
mod tests;

use std::collections::VecDeque;
use std::time::Duration;

use fiatlux_proto::limits::{ACK_PERIOD, MAX_SERVER_MESSAGE, RECORDER_TIMEOUT};
use fiatlux_proto::v3::{EpisodeHeader, EpisodeResult, StepRecord, StepRecordAck};
use fiatlux_proto::{Bytes, Message, decode};

use crate::machine::Machine;
pub use order::MAX_WAITING;
use order::{Next, Order};

/// An acknowledgement waits until it covers this many records, or for at most half of the longest time allowed.
const RECORDS_PER_ACK: u64 = 64;

/// A server that is gone for this time will not come back to finish its episode.
const SERVER_TIMEOUT: Duration = RECORDER_TIMEOUT;

/// An input of a recorder of one session.
#[derive(Debug)]
pub enum Input {
    /// A [`StepRecord`], published or in reply to a request, in any order.
    StepRecord(Bytes),
    /// The query of a request has ended.
    Answered,
    /// The session's liveliness token has appeared.
    ServerSeen,
    /// The session's liveliness token is gone.
    ServerGone,
    /// All rows of the open bag before this step are on disk; 0 if no bag is open.
    OnDisk(u64),
    /// The last write failed, and its bag is given up: the rest of its episode is dropped and not acknowledged. These rows are
    /// skipped once a later episode has its bag.
    /// Says why, for the server and its client.
    WriteFailed(String),
    /// Nothing has arrived; only time has passed.
    Tick,
}

/// Requests of a recorder to its caller.
#[derive(Debug, PartialEq)]
pub enum Output {
    /// Write this, then report what is on disk.
    Write(Write),
    /// Query `truth/rows` with this [`StepRecordRequest`](fiatlux_proto::v3::StepRecordRequest). All replies have the same key:
    /// switch Zenoh's consolidation off for the query.
    Request(Bytes),
    /// Publish this [`StepRecordAck`] on `truth/ack`.
    Ack(Bytes),
    /// This many records are in no bag: the server had dropped them, or their bag had to be given up.
    Lost(u64),
    /// Nothing more will come, and no bag is open.
    Done,
}

/// Data to write into a bag.
#[derive(Debug, PartialEq)]
pub enum Write {
    /// Begin a new bag with this header.
    Open(Box<EpisodeHeader>),
    /// A row, or the events that end an episode without one.
    Row(Box<StepRecord>),
    /// The bag is complete; close it.
    Finish(Box<EpisodeResult>),
    /// The bag ends before its episode, for this reason; close it.
    Cut(String),
}

#[derive(Debug, Clone, Copy)]
struct OpenBag {
    episode: u64,
    /// Step of the row that comes next.
    next_step: u64,
}

/// A bag that could not be written.
#[derive(Debug)]
struct Loss {
    /// No record from this one on is acknowledged.
    from: u64,
    problem: String,
}

/// Puts the records of one session into bags.
#[derive(Debug)]
pub struct RecorderSession {
    /// Name of the recorder, which its acknowledgements carry.
    name: String,
    order: Order,
    open: Option<OpenBag>,
    /// Header of a bag that is resumed, until its first record.
    resumed: Option<EpisodeHeader>,
    /// Record number that row 0 of the open bag's episode has, or would have.
    first_seq: Option<u64>,
    /// The step after the last row on disk of the open bag.
    on_disk: u64,
    writes: VecDeque<Write>,
    /// When the session's token went away.
    gone_at: Option<Duration>,
    is_done: bool,
    told_lost: bool,
    acked: u64,
    /// Number of the record after the last bag that ended.
    whole_to: u64,
    /// Episode of the last bag.
    episode: u64,
    /// Set when the last bag could not be written, until another one is open.
    lost: Option<Loss>,
    ack_at: Duration,
    /// A bag has ended since the last acknowledgement.
    bag_ended: bool,
    now: Duration,
}

impl Machine for RecorderSession {
    type Input = Input;
    type Output = Output;

    fn handle(&mut self, input: Input, now: Duration) {
        self.now = now;
        match input {
            Input::StepRecord(bytes) => match decode::<StepRecord>(&bytes, MAX_SERVER_MESSAGE) {
                Ok(record) => self.order.take(record, now),
                Err(error) => tracing::warn!(%error, "dropped an unreadable record; is the server of this version?"),
            },
            Input::Answered => self.order.answered(now),
            Input::ServerSeen => self.gone_at = None,
            Input::ServerGone => self.gone_at = self.gone_at.or(Some(now)),
            Input::OnDisk(next_step) => {
                self.on_disk = next_step;
                if self.open.is_none() && self.writes.is_empty() {
                    self.whole_to = self.order.next_seq();
                }
            }
            Input::WriteFailed(problem) => {
                self.lost = Some(Loss { from: self.acked.max(self.whole_to), problem });
                self.ack_at = now;
                self.open = None;
                self.first_seq = None;
                self.bag_ended = false;
                self.writes.clear();
            }
            Input::Tick => {}
        }
    }

    /// Writes come first, so that requests and acknowledgements take into account what they put on disk.
    fn poll(&mut self) -> Option<Output> {
        while self.writes.is_empty() {
            match self.order.next() {
                Some(Next::StepRecord(record)) => self.write(record),
                Some(Next::Lost { from, to }) => {
                    let lost = to - from;
                    if self.open.is_none() {
                        return Some(Output::Lost(lost));
                    }
                    self.cut(&format!("{lost} rows were lost: the recorder was away, or too slow, for too long"));
                }
                None => return self.poll_server(),
            }
        }
        self.writes.pop_front().map(Output::Write)
    }

    fn wake_at(&self) -> Option<Duration> {
        if self.is_done {
            return None;
        }
        let gone = self.gone_at.map(|at| at + if self.open.is_some() { SERVER_TIMEOUT } else { ACK_PERIOD });
        [self.order.wake_at(), Some(self.ack_at), gone].into_iter().flatten().min()
    }
}

impl RecorderSession {
    /// A session of which nothing is on disk, for the recorder of this name.
    pub fn new(name: &str, now: Duration) -> Self {
        Self {
            name: name.into(),
            order: Order::new(false, now),
            open: None,
            resumed: None,
            first_seq: None,
            on_disk: 0,
            writes: VecDeque::new(),
            gone_at: None,
            is_done: false,
            told_lost: false,
            acked: 0,
            whole_to: 0,
            episode: 0,
            lost: None,
            ack_at: now,
            bag_ended: false,
            now,
        }
    }

    /// A session with complete bags on disk and no open one. Records that the server no longer has are in these bags.
    pub fn again(name: &str, now: Duration) -> Self {
        Self { order: Order::new(true, now), ..Self::new(name, now) }
    }

    /// A session with an open bag of this header, which has all rows before `next_step`. Until [`Input::OnDisk`] says how
    /// many of them are on disk, none is acknowledged: rows after the last whole chunk may be in memory alone.
    pub fn resume(name: &str, header: EpisodeHeader, next_step: u64, now: Duration) -> Self {
        Self {
            order: Order::new(true, now),
            open: Some(OpenBag { episode: header.episode, next_step }),
            episode: header.episode,
            resumed: Some(header),
            ..Self::new(name, now)
        }
    }

    /// Next request or news for the server, once everything is written.
    fn poll_server(&mut self) -> Option<Output> {
        if let Some(request) = self.order.request(self.now) {
            return Some(Output::Request(request.encode_to_vec().into()));
        }
        let next_seq = self.next_seq();
        let is_due = std::mem::take(&mut self.bag_ended) || next_seq >= self.acked + RECORDS_PER_ACK;
        if is_due && next_seq != self.acked || self.now >= self.ack_at {
            self.acked = next_seq;
            self.ack_at = self.now + self.order.pace(ACK_PERIOD / 2, self.now);
            let problem = self.lost.as_ref().map(|lost| lost.problem.clone()).unwrap_or_default();
            let ack = StepRecordAck { recorder: self.name.clone(), next_seq, problem, lost_episode: self.episode };
            return Some(Output::Ack(ack.encode_to_vec().into()));
        }
        let gone_for = self.now.saturating_sub(self.gone_at?);
        if self.open.is_some() && gone_for >= SERVER_TIMEOUT {
            self.cut("the server went away before the episode ended");
            return self.writes.pop_front().map(Output::Write);
        }
        // Records sent before the token went away may still be on their way.
        let is_done = self.open.is_none() && gone_for >= ACK_PERIOD;
        if !is_done || self.is_done {
            return None;
        }
        let lost = self.order.next_seq().saturating_sub(next_seq) + self.order.waiting() as u64;
        if lost > 0 && !std::mem::replace(&mut self.told_lost, true) {
            return Some(Output::Lost(lost));
        }
        self.is_done = true;
        Some(Output::Done)
    }

    /// Number of the first record that is not on disk.
    fn next_seq(&self) -> u64 {
        if let Some(lost) = &self.lost {
            return lost.from;
        }
        match (self.open, self.first_seq) {
            (None, _) => self.order.next_seq(),
            (Some(_), Some(first)) => first.saturating_add(self.on_disk).min(self.order.next_seq()),
            // Resumed, and nothing has come yet.
            (Some(_), None) => 0,
        }
    }

    fn cut(&mut self, reason: &str) {
        if self.open.take().is_some() {
            self.bag_ended = true;
            self.writes.push_back(Write::Cut(reason.into()));
        }
    }

    fn write(&mut self, mut record: Box<StepRecord>) {
        // The bags before the resumed one are complete on disk; the earlier recorder died before it could acknowledge them.
        if self.resumed.is_some() && self.open.is_some_and(|open| record.episode < open.episode) {
            return;
        }
        let begins = record.step == 0 && record.header.is_some();
        let goes_on = self.open.is_some_and(|open| open.episode == record.episode);
        // A first row can belong to an open bag only if its recorder died before acknowledging it.
        if !goes_on || begins && record.header != self.resumed {
            self.cut("the session went on to another episode");
            // Only its first row opens a bag; what follows a cut is dropped.
            let (true, Some(header)) = (begins, record.header.take()) else { return };
            self.open = Some(OpenBag { episode: record.episode, next_step: 0 });
            self.on_disk = 0;
            self.episode = record.episode;
            self.lost = None;
            self.writes.push_back(Write::Open(Box::new(header)));
        }
        self.resumed = None;
        let Some(open) = &mut self.open else { return };
        let is_row = !record.state.is_empty();
        // A record without a row follows the last one of its episode.
        let place = if is_row { record.step } else { record.step.saturating_add(1) };
        self.first_seq = Some(record.seq.saturating_sub(place));
        if place > open.next_step {
            let (next, step) = (open.next_step, record.step);
            return self.cut(&format!("row {step} came after row {}", next.saturating_sub(1)));
        }
        let result = record.result.take();
        let is_on_disk = is_row && place < open.next_step;
        if !is_on_disk {
            open.next_step += u64::from(is_row);
            self.writes.push_back(Write::Row(record));
        }
        // The last row may be on disk without the result that came with it.
        if let Some(result) = result {
            self.open = None;
            self.first_seq = None;
            self.bag_ended = true;
            self.writes.push_back(Write::Finish(Box::new(result)));
        }
    }
}
