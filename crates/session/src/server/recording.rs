//! Serves a session's recorder: keeps records until they are acknowledged, and in lockstep waits for the recorder.

use std::time::Duration;

use fiatlux_proto::v3::notice::Code as NoticeCode;
use fiatlux_proto::v3::{Refusal, StepRecord, StepRecordAck, StepRecordRequest};
use fiatlux_proto::{decode, limits};

use super::{Deferred, Host, Output, Phase, ServerSession};

/// State of the recording.
#[derive(Debug, Default)]
pub(super) struct Recording {
    /// A recorder has acknowledged something.
    pub registered: bool,
    /// When the session began to wait for room in the window.
    pub waiting_since: Option<Duration>,
    /// The recorder is gone: the session goes on without one until a recorder is heard from.
    lost: bool,
    /// When an acknowledgement last freed a record.
    last_progress: Duration,
    /// Episode of the last record.
    pub episode: u64,
    /// The episode whose bag the recorder cannot write.
    failed: Option<u64>,
}

impl Recording {
    /// True if no recorder takes the present episode's records.
    pub fn is_lost(&self) -> bool {
        self.lost || self.has_failed()
    }

    /// True if the present episode's bag cannot be written.
    fn has_failed(&self) -> bool {
        self.failed == Some(self.episode)
    }
}

impl<H: Host, R> ServerSession<H, R> {
    /// True if the next row has to wait for the recorder; starts the wait if so.
    pub(super) fn must_wait(&mut self, now: Duration) -> bool {
        let waits = self.recorded && !self.is_real_time() && !self.recording.is_lost() && self.window.is_full();
        if waits {
            self.recording.waiting_since.get_or_insert(now);
        }
        waits
    }

    /// True if a recorder takes the records, or is still expected.
    pub(super) fn has_recorder(&self) -> bool {
        self.recorded || self.recording.registered
    }

    pub(super) fn publish_record(&mut self, mut record: StepRecord, now: Duration) {
        self.recording.episode = record.episode;
        let waits = self.recorded && !self.is_real_time() && !self.recording.is_lost();
        if self.recorded && self.is_real_time() && self.window.is_full() && !self.recording.is_lost() {
            self.lose_recorder("the recorder is too slow for real time", now);
        }
        let bytes = self.window.push(&mut record, !waits);
        self.outputs.push_back(Output::StepRecord(bytes));
    }

    pub(super) fn on_ack(&mut self, bytes: &[u8], now: Duration) {
        let ack: StepRecordAck = match decode(bytes, limits::MAX_CLIENT_MESSAGE) {
            Ok(ack) => ack,
            Err(error) => {
                return tracing::debug!(session = self.info.session, %error, "an acknowledgement cannot be read");
            }
        };
        if ack.next_seq > self.window.next_seq() {
            let next = self.window.next_seq();
            return tracing::debug!(
                session = self.info.session,
                ack.next_seq,
                next,
                "acknowledgement of records that do not exist"
            );
        }
        self.recording.registered = true;
        self.recording.lost = false;
        if self.window.acknowledge(&ack) > 0 {
            self.recording.last_progress = now;
        }
        let StepRecordAck { problem, lost_episode, .. } = ack;
        let failed = (!problem.is_empty()).then_some(lost_episode);
        if std::mem::replace(&mut self.recording.failed, failed) != failed && failed.is_some() {
            let why = format!("the recorder cannot write the bag of episode {lost_episode}: {problem}");
            self.tell_lost(&why, "have its owner see to the recorder's disk, and play the episode again", now);
        }
        if !self.window.is_full() || self.recording.is_lost() {
            self.go_on(now);
        }
    }

    pub(super) fn on_records(&mut self, bytes: &[u8], to: R) {
        match decode::<StepRecordRequest>(bytes, limits::MAX_CLIENT_MESSAGE) {
            Ok(request) => {
                let records = self.window.get(&request);
                self.outputs.push_back(Output::Reply(to, "StepRecord", records));
            }
            Err(error) => self.refuse(to, &Refusal::from(&error)),
        }
    }

    /// Gives up on a recorder that has not acknowledged in time.
    pub(super) fn stop_waiting_for_recorder(&mut self, now: Duration) {
        if self.recording.waiting_since.is_some_and(|since| now >= since + self.timeouts.recorder) {
            let secs = self.timeouts.recorder.as_secs_f64();
            let what = if self.recording.registered { "has acknowledged nothing" } else { "has shown up" };
            let who = if self.recording.registered { "the recorder" } else { "no recorder" };
            self.lose_recorder(&format!("{who} {what} for {secs} s"), now);
            self.go_on(now);
        }
    }

    /// When a closed session stops waiting for its recorder; `None` if everything is acknowledged.
    pub(super) fn drained_at(&self) -> Option<Duration> {
        let Phase::Draining(since) = self.phase else { return None };
        (!self.window.is_empty() && !self.recording.has_failed())
            .then(|| since.max(self.recording.last_progress) + self.timeouts.recorder)
    }

    fn lose_recorder(&mut self, why: &str, now: Duration) {
        self.recording.lost = true;
        let remedy = if self.recording.registered {
            "see the recorder's log, its disk and its link: it runs, and falls behind or is cut off"
        } else {
            "start a recorder for this server, with the same --recorder-key; one that runs with another key says so in its log"
        };
        self.tell_lost(why, remedy, now);
    }

    fn tell_lost(&mut self, why: &str, remedy: &str, now: Duration) {
        self.note("lost", "recorder", why.into());
        let message = format!("{why}: the episode goes on, but its recording is cut");
        self.notify(NoticeCode::Lost, 1, "recorded", message, remedy, now);
    }

    /// Handles the input that waited for room.
    fn go_on(&mut self, now: Duration) {
        self.recording.waiting_since = None;
        match self.deferred.take() {
            Some(Deferred::Action(received)) => self.advance_deferred(*received, now),
            Some(Deferred::Reset(episode, to)) => self.reset(episode, to, now),
            None => {}
        }
    }
}
