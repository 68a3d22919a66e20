//! A server's side of a session. It follows the rules in `proto/PROTOCOL.md`.

mod action;
mod host;
mod message;
mod notices;
mod recording;
#[cfg(test)]
mod tests;
mod window;

use std::collections::VecDeque;
use std::time::Duration;

use fiatlux_proto::v3::notice::Code as NoticeCode;
use fiatlux_proto::v3::refusal::Code as RefusalCode;
use fiatlux_proto::v3::{
    CloseReply, CloseRequest, Event, LookReply, LookRequest, Mode, Notice, Observation, Refusal, ResetReply,
    ResetRequest, SessionInfo, StepRecord, look_reply, reset_reply,
};
use fiatlux_proto::{ABORTED, Bytes, Message, STOPPED, decode, limits};

use crate::machine::Machine;
use action::{Clock, ReceivedAction, Unrecorded};
pub use host::Host;
pub use message::{Input, Output, Timeouts};
use notices::NoticeLimiter;
use recording::Recording;
use window::RecordWindow;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Phase {
    Open,
    /// Closed at this time; records still wait for their recorder.
    Draining(Duration),
    Done,
}

/// An episode that is running or has ended with a row; an aborted one is dropped.
#[derive(Debug)]
struct Run {
    episode: u64,
    step: u64,
    is_over: bool,
    /// The present observation as published, and the time of publication.
    observation: Bytes,
    observed_at: Duration,
    /// The clock of a real-time session, from the first action on.
    clock: Option<Clock>,
    /// Number of steps in real time for which no new action came.
    missed_steps: u64,
}

impl Run {
    fn new(first: &Observation, now: Duration) -> Self {
        let observation = first.encode_to_vec().into();
        let Observation { episode, step, .. } = *first;
        Self {
            episode,
            step,
            is_over: first.end.is_some(),
            observation,
            observed_at: now,
            clock: None,
            missed_steps: 0,
        }
    }
}

/// Input that waits for room in the recording window.
#[derive(Debug)]
enum Deferred<R> {
    Action(Box<ReceivedAction>),
    Reset(u64, R),
}

/// One client's session on a server, with the simulation `H`. `R` says where replies go.
#[derive(Debug)]
pub struct ServerSession<H, R> {
    host: H,
    info: SessionInfo,
    recorded: bool,
    timeouts: Timeouts,
    phase: Phase,
    run: Option<Run>,
    /// The step whose observation is sent, but whose record is not made yet.
    unrecorded: Option<Unrecorded>,
    window: RecordWindow,
    deferred: Option<Deferred<R>>,
    recording: Recording,
    /// Where the reply to `close` goes, which waits for the recorder.
    closing: Option<R>,
    notices: NoticeLimiter,
    /// When the client's token went away.
    client_gone: Option<Duration>,
    /// When the session began to wait for its client.
    client_silent: Duration,
    /// Events since the last row.
    events: Vec<Event>,
    /// Number of refused actions that are no longer listed among the events.
    refused: u64,
    outputs: VecDeque<Output<R>>,
}

/// Longest time for which the reply to `close` waits until all records are on disk; clients wait for 3 s.
const CLOSE_WAIT: Duration = Duration::from_secs(2);

/// Most events between two rows that are recorded one by one; further ones are only counted.
pub const MAX_EVENTS: usize = 16;

impl<H: Host, R> Machine for ServerSession<H, R> {
    type Input = Input<R>;
    type Output = Output<R>;

    fn handle(&mut self, input: Input<R>, now: Duration) {
        self.record_step();
        match input {
            Input::Action(bytes) => self.on_action(&bytes, now),
            Input::Reset(bytes, to) => self.on_reset(&bytes, to, now),
            Input::Close(bytes, to) => self.on_close(&bytes, to, now),
            Input::Observation(to) => match &self.run {
                Some(run) => {
                    let replies = vec![run.observation.clone()];
                    self.outputs.push_back(Output::Reply(to, "Observation", replies));
                }
                None => self.refuse(to, &no_episode()),
            },
            Input::Look(bytes, to) => {
                let seen = self.look(&bytes);
                let reply = seen.map_or_else(look_reply::Reply::Refusal, look_reply::Reply::Observation);
                self.reply(to, "LookReply", &LookReply { reply: Some(reply) });
            }
            Input::ClientSeen => self.client_gone = None,
            Input::ClientGone => self.client_gone = self.client_gone.or(Some(now)),
            Input::Ack(bytes) => self.on_ack(&bytes, now),
            Input::StepRecords(bytes, to) => self.on_records(&bytes, to),
            Input::Dropped(count) => {
                let message = format!("{count} messages found {} others waiting", limits::MAX_WAITING_MESSAGES);
                let remedy = "send one action for each observation, and repeat it only after resend_s";
                self.notify(NoticeCode::Rate, count, "", message, remedy, now);
            }
            Input::TooLarge(length) => {
                let message = format!("a message of {length} bytes; the limit is {}", limits::MAX_CLIENT_MESSAGE);
                self.notify(NoticeCode::Size, 1, "", message, "send one action in each message", now);
            }
            Input::Terminate(why) => self.terminate(why, now),
            Input::Tick => {}
        }
        self.pass_time(now);
    }

    /// Records a row after its observation is sent, so that a client on another core can act meanwhile.
    fn poll(&mut self) -> Option<Output<R>> {
        if self.outputs.is_empty() {
            self.record_step();
        }
        self.outputs.pop_front()
    }

    fn wake_at(&self) -> Option<Duration> {
        let timeouts = &self.timeouts;
        let mut wake = self.notices.wake_at();
        let mut at = |time: Option<Duration>| wake = wake.into_iter().chain(time).min();
        match self.phase {
            Phase::Done => return None,
            Phase::Draining(since) => {
                at(self.drained_at());
                at(self.closing.as_ref().map(|_| since + CLOSE_WAIT));
            }
            Phase::Open => {
                at(self.client_gone.map(|since| since + timeouts.grace));
                at(self.recording.waiting_since.map(|since| since + timeouts.recorder));
                if self.deferred.is_none() {
                    at(self.client_silent.checked_add(self.action_timeout()));
                }
                at(self.run.as_ref().and_then(|run| run.clock.as_ref()).map(|clock| clock.next_step));
            }
        }
        wake
    }
}

impl<H: Host, R> ServerSession<H, R> {
    /// A session without an episode yet. Its timeouts go into `info`, which describes it to its client; robot, mode
    /// and control step in force are read from there. A `recorded` session waits for a recorder.
    pub fn new(host: H, info: SessionInfo, recorded: bool, timeouts: Timeouts, now: Duration) -> Self {
        let is_real_time = info.mode() == Mode::RealTime;
        let info = SessionInfo {
            action_timeout_s: if is_real_time { timeouts.action } else { timeouts.lockstep }.as_secs_f64(),
            grace_s: timeouts.grace.as_secs_f64(),
            resend_s: timeouts.resend.as_secs_f64(),
            ..info
        };
        Self {
            host,
            info,
            recorded,
            timeouts,
            phase: Phase::Open,
            run: None,
            unrecorded: None,
            window: RecordWindow::default(),
            deferred: None,
            recording: Recording::default(),
            closing: None,
            notices: NoticeLimiter::default(),
            client_gone: Some(now + timeouts.claim.saturating_sub(timeouts.grace)),
            client_silent: now,
            events: Vec::new(),
            refused: 0,
            outputs: VecDeque::new(),
        }
    }

    /// The description that the client gets.
    pub fn info(&self) -> &SessionInfo {
        &self.info
    }

    /// The simulation that this session runs.
    pub fn host(&self) -> &H {
        &self.host
    }

    /// True if the server can stop now without losing anything.
    pub fn is_settled(&self) -> bool {
        let draining = matches!(self.phase, Phase::Draining(_)) && !self.recorded && !self.recording.registered;
        self.phase == Phase::Done || draining
    }

    fn is_real_time(&self) -> bool {
        self.info.mode() == Mode::RealTime
    }

    /// Longest wait for an action.
    fn action_timeout(&self) -> Duration {
        if self.is_real_time() { self.timeouts.action } else { self.timeouts.lockstep }
    }

    fn pass_time(&mut self, now: Duration) {
        let due = self.notices.due(now);
        self.send_notice(due);
        if self.phase == Phase::Open {
            self.step_by_the_clock(now);
            self.stop_waiting_for_recorder(now);
            if self.client_gone.is_some_and(|since| now >= since + self.timeouts.grace) {
                let secs = self.timeouts.grace.as_secs_f64();
                self.terminate(&format!("the client has shown no liveliness token for {secs} s"), now);
            } else if self.deferred.is_none() && now.saturating_sub(self.client_silent) >= self.action_timeout() {
                let secs = self.action_timeout().as_secs_f64();
                self.terminate(&format!("no action has come for {secs} s"), now);
            }
        }
        self.finish_draining(now);
    }

    fn finish_draining(&mut self, now: Duration) {
        let Phase::Draining(since) = self.phase else { return };
        let is_drained = self.drained_at().is_none_or(|at| now >= at);
        if (is_drained || self.recording.is_lost() || now >= since + CLOSE_WAIT)
            && let Some(to) = self.closing.take()
        {
            self.reply(to, "CloseReply", &CloseReply::default());
        }
        if is_drained {
            self.phase = Phase::Done;
            self.run = None;
            self.outputs.push_back(Output::Done);
        }
    }

    fn on_reset(&mut self, bytes: &[u8], to: R, now: Duration) {
        let request: ResetRequest = match decode(bytes, limits::MAX_CLIENT_MESSAGE) {
            Ok(request) => request,
            Err(error) => return self.reply_to_reset(to, Err(Refusal::from(&error))),
        };
        if self.phase != Phase::Open {
            return self.reply_to_reset(to, Err(closed()));
        }
        if let Some(run) = &self.run
            && run.episode == request.episode
            && run.step == 0
            && run.clock.is_none()
            && self.deferred.is_none()
        {
            self.client_silent = now;
            let again = Observation::decode(run.observation.clone()).unwrap_or_default();
            return self.reply_to_reset(to, Ok(again));
        }
        if let Some(Deferred::Reset(_, other)) = self.deferred.take() {
            let refusal = Refusal::new(RefusalCode::Value, "", "another reset has come since");
            self.reply_to_reset(other, Err(refusal));
        }
        if self.must_wait(now) {
            self.deferred = Some(Deferred::Reset(request.episode, to));
        } else {
            self.reset(request.episode, to, now);
        }
    }

    fn reset(&mut self, episode: u64, to: R, now: Duration) {
        self.client_silent = now;
        self.cut_short(self.clients_end(), "another episode was asked for", now);
        let large = self.has_recorder();
        let staged = self.host.stage(episode).cloned();
        let staged = staged.and_then(|first| Ok((first, self.host.record(None, large)?)));
        let (first, record) = match staged {
            Ok(staged) => staged,
            Err(refusal) => return self.reply_to_reset(to, Err(refusal)),
        };
        self.run = Some(Run::new(&first, now));
        self.events.clear();
        self.refused = 0;
        self.reply_to_reset(to, Ok(first));
        self.publish_record(record, now);
    }

    fn on_close(&mut self, bytes: &[u8], to: R, now: Duration) {
        let refusal = match decode::<CloseRequest>(bytes, limits::MAX_CLIENT_MESSAGE) {
            Err(error) => Some(Refusal::from(&error)),
            Ok(_) if self.phase != Phase::Open => Some(closed()),
            Ok(_) => {
                self.shut(self.clients_end(), "the client closed the session", now);
                if self.recorded {
                    self.closing = Some(to);
                    return;
                }
                None
            }
        };
        self.reply(to, "CloseReply", &CloseReply { refusal });
    }

    /// Closes the session for a reason that the client did not ask for.
    fn terminate(&mut self, why: &str, now: Duration) {
        if self.phase == Phase::Open {
            self.notify(NoticeCode::Lost, 1, "", format!("the session is closed: {why}"), "open another one", now);
            self.shut(ABORTED, why, now);
        }
    }

    fn shut(&mut self, cause: &str, why: &str, now: Duration) {
        if let Some(Deferred::Reset(_, to)) = self.deferred.take() {
            self.reply_to_reset(to, Err(closed()));
        }
        self.cut_short(cause, why, now);
        // Sent now, since nobody may be listening later.
        let held = self.notices.flush();
        self.send_notice(held);
        self.phase = Phase::Draining(now);
        self.outputs.push_back(Output::Closed);
    }

    /// The cause of an end that the client asks for while an episode runs. A take without a step is no take.
    fn clients_end(&self) -> &'static str {
        let has_begun = self.run.as_ref().is_some_and(|run| run.step > 0);
        if self.info.take && has_begun { STOPPED } else { ABORTED }
    }

    /// Ends the running episode without a last row.
    fn cut_short(&mut self, cause: &str, why: &str, now: Duration) {
        self.record_step();
        let Some(run) = self.run.take().filter(|run| !run.is_over) else { return };
        let mut result = self.host.cut_short(cause, why);
        result.missed_steps = run.missed_steps;
        self.host.sign(&mut result);
        let ending = Event {
            step: run.step,
            kind: "end".into(),
            subject: cause.into(),
            change: cause.into(),
            detail: why.into(),
        };
        let events = self.take_events(run.step).chain([ending]);
        let record = StepRecord {
            episode: run.episode,
            step: run.step,
            events: events.map(|event| event.encode_to_vec()).collect(),
            result: Some(result),
            ..StepRecord::default()
        };
        self.publish_record(record, now);
    }

    /// Answers a look: sensors at the present step, for a client that has not acted yet.
    fn look(&mut self, bytes: &[u8]) -> Result<Observation, Refusal> {
        let request: LookRequest = decode(bytes, limits::MAX_CLIENT_MESSAGE).map_err(|error| Refusal::from(&error))?;
        if self.phase != Phase::Open {
            return Err(closed());
        }
        let Some(run) = &self.run else { return Err(no_episode()) };
        for (field, asked, present) in [("episode", request.episode, run.episode), ("step", request.step, run.step)] {
            if asked != present {
                let message = format!("{field} {asked} is not the present one, {present}; look before you act");
                return Err(Refusal::new(RefusalCode::Value, field, message));
            }
        }
        self.host.look(&request.sensors)
    }

    fn reply(&mut self, to: R, name: &'static str, message: &impl Message) {
        self.outputs.push_back(Output::Reply(to, name, vec![message.encode_to_vec().into()]));
    }

    fn reply_to_reset(&mut self, to: R, first: Result<Observation, Refusal>) {
        let reply = first.map_or_else(reset_reply::Reply::Refusal, reset_reply::Reply::Observation);
        self.reply(to, "ResetReply", &ResetReply { reply: Some(reply) });
    }

    fn refuse(&mut self, to: R, refusal: &Refusal) {
        self.outputs.push_back(Output::Refuse(to, refusal.encode_to_vec().into()));
    }

    fn notify(&mut self, code: NoticeCode, count: u64, field: &str, message: String, remedy: &str, now: Duration) {
        let (episode, step) = self.run.as_ref().map_or((self.recording.episode, 0), |run| (run.episode, run.step));
        let (field, remedy) = (field.to_owned(), remedy.to_owned());
        let notice = Notice { code: code.into(), episode, step, field, message, remedy, count };
        let offered = self.notices.offer(notice, now);
        self.send_notice(offered);
    }

    fn send_notice(&mut self, notice: Option<Notice>) {
        self.outputs.extend(notice.map(|notice| Output::Notice(notice.encode_to_vec().into())));
    }

    /// Notes an event between two rows.
    fn note(&mut self, kind: &str, subject: &str, detail: String) {
        if self.run.as_ref().is_none_or(|run| run.is_over) {
            return;
        }
        if self.events.len() < MAX_EVENTS {
            let event = Event { kind: kind.into(), subject: subject.into(), detail, ..Event::default() };
            self.events.push(event);
        } else {
            self.refused += 1;
        }
    }

    /// The noted events, for the record of the step.
    fn take_events(&mut self, step: u64) -> impl Iterator<Item = Event> + use<H, R> {
        let more = std::mem::take(&mut self.refused);
        let more = (more > 0).then(|| Event {
            kind: "refused".into(),
            subject: "more".into(),
            detail: format!("{more} more"),
            ..Event::default()
        });
        let events = std::mem::take(&mut self.events);
        events.into_iter().chain(more).map(move |event| Event { step, ..event })
    }
}

fn closed() -> Refusal {
    Refusal::new(RefusalCode::Closed, "", "the session is closed; open another one")
}

fn no_episode() -> Refusal {
    Refusal::new(RefusalCode::Value, "", "no episode runs; send reset")
}
