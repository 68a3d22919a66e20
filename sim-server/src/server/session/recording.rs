//! What a session does for its recorder: it keeps truths, and in lockstep it waits.

use std::time::Duration;

use fiatlux_proto::v3::notice::Code as NoticeCode;
use fiatlux_proto::v3::{StepRecord, StepRecordAck, StepRecordRequest};
use fiatlux_proto::{decode, limits};
use zenoh::bytes::ZBytes;

use super::{Held, Output, Phase, Session, Sink, refuse};
use crate::server::plan::malformed;

/// How the recording stands.
#[derive(Debug, Default)]
pub(super) struct Recording {
    /// Some recorder has acknowledged something.
    pub registered: bool,
    /// Since when the session waits for room in the window.
    pub waiting_since: Option<Duration>,
    /// The recorder is gone: the session goes on without, until one is heard of.
    lost: bool,
    /// When an acknowledgement last freed something.
    last_progress: Duration,
}

impl<R> Session<R> {
    /// Whether the next row has to wait for the recorder; if so, the wait begins.
    pub(super) fn must_wait(&mut self, now: Duration) -> bool {
        let waits = self.plan.recorded && !self.plan.real_time && !self.recording.lost && self.window.is_full();
        if waits {
            self.recording.waiting_since.get_or_insert(now);
        }
        waits
    }

    /// Whether somebody takes its truths, or is waited for.
    pub(super) fn has_recorder(&self) -> bool {
        self.plan.recorded || self.recording.registered
    }

    pub(super) fn publish_truth(&mut self, mut truth: StepRecord, now: Duration, out: Sink<'_, R>) {
        let waits = self.plan.recorded && !self.plan.real_time && !self.recording.lost;
        if self.plan.recorded && self.plan.real_time && self.window.is_full() && !self.recording.lost {
            self.lose_recorder("the recorder is too slow for real time", now, out);
        }
        let bytes = self.window.push(&mut truth, !waits);
        out(Output::StepRecord(bytes));
    }

    pub(super) fn on_ack(&mut self, bytes: &ZBytes, now: Duration, out: Sink<'_, R>) {
        let ack: StepRecordAck = match decode(&bytes.to_bytes(), limits::MAX_CLIENT_MESSAGE) {
            Ok(ack) => ack,
            Err(error) => return tracing::debug!(session = self.id, %error, "acknowledgement passed over"),
        };
        if ack.next_seq > self.window.next_seq() {
            let next = self.window.next_seq();
            return tracing::debug!(session = self.id, ack.next_seq, next, "acknowledgement of what does not exist");
        }
        self.recording.registered = true;
        self.recording.lost = false;
        if self.window.acknowledge(&ack) > 0 {
            self.recording.last_progress = now;
        }
        if !self.window.is_full() {
            self.go_on(now, out);
        }
    }

    pub(super) fn on_truths(&mut self, bytes: &ZBytes, to: R, out: Sink<'_, R>) {
        match decode::<StepRecordRequest>(&bytes.to_bytes(), limits::MAX_CLIENT_MESSAGE) {
            Ok(request) => out(Output::Reply(to, "StepRecord", self.window.get(&request))),
            Err(error) => refuse(to, &malformed(&error), out),
        }
    }

    /// Gives up on a recorder that has not made room in time.
    pub(super) fn stop_waiting_for_recorder(&mut self, now: Duration, out: Sink<'_, R>) {
        if self.recording.waiting_since.is_some_and(|since| now >= since + self.times.recorder_timeout) {
            let secs = self.times.recorder_timeout.as_secs_f64();
            let what = if self.recording.registered { "has acknowledged nothing" } else { "has shown up" };
            let who = if self.recording.registered { "the recorder" } else { "no recorder" };
            self.lose_recorder(&format!("{who} {what} for {secs} s"), now, out);
            self.go_on(now, out);
        }
    }

    /// When a session that is closed stops waiting for its recorder; none when all is acknowledged.
    pub(super) fn drained_at(&self) -> Option<Duration> {
        let Phase::Draining(since) = self.phase else { return None };
        (!self.window.is_empty()).then(|| since.max(self.recording.last_progress) + self.times.recorder_timeout)
    }

    fn lose_recorder(&mut self, why: &str, now: Duration, out: Sink<'_, R>) {
        self.recording.lost = true;
        self.note("lost", "recorder", why.into());
        let message = format!("{why}: the episode goes on, its recording is cut");
        self.notify(NoticeCode::Lost, 1, "recorded", message, "start a recorder for this server", now, out);
    }

    /// Does what waited for room.
    fn go_on(&mut self, now: Duration, out: Sink<'_, R>) {
        self.recording.waiting_since = None;
        match self.held.take() {
            Some(Held::Action(asked)) => self.advance_held(asked, now, out),
            Some(Held::Reset(index, to)) => self.reset(index, to, now, out),
            None => {}
        }
    }
}
