//! A session as a state machine: messages and the time go in, messages come out. It reads no clock and does no I/O; the
//! rules that it follows are those of `proto/PROTOCOL.md`.

mod act;
mod look;
mod message;
mod recording;
#[cfg(test)]
mod tests;

use std::time::Duration;

use fiatlux_features::ResNet18;
use fiatlux_link::in_full;
use fiatlux_proto::v3::notice::Code as NoticeCode;
use fiatlux_proto::v3::refusal::Code as RefusalCode;
use fiatlux_proto::v3::{CloseReply, CloseRequest, Event, Notice, Observation, ResetRequest, SessionInfo};
use fiatlux_proto::{Message, decode, limits};
use fiatlux_render::Lighting;
use fiatlux_world::Episode;
use zenoh::bytes::ZBytes;

use super::info;
use super::notices::Notices;
use super::plan::{Plan, malformed, refusal};
use super::record::{self, Record};
use super::scenes::Built;
use super::window::Window;
use crate::senses::Senses;
use act::{Asked, Clock};
use look::{observe, recorded};
pub(super) use message::{Input, Output, Sink, Times};
use message::{closed, looked, refuse, reset_refused, reset_replied};

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Phase {
    Open,
    /// Closed at that time; truths wait for their recorder.
    Draining(Duration),
    Done,
}

/// An episode that runs or has ended with a row; one that was aborted is gone.
#[derive(Debug)]
struct Run {
    episode: Episode,
    record: Record,
    /// The present observation, as published, and when.
    observation: ZBytes,
    observed_at: Duration,
    /// Real time, from the first action on.
    clock: Option<Clock>,
    missed: record::Missed,
}

impl Run {
    fn index(&self) -> u64 {
        self.episode.spec().episode
    }

    fn step(&self) -> u64 {
        self.episode.row().step
    }

    fn is_over(&self) -> bool {
        self.episode.end().is_some()
    }
}

/// What waits for room in the recording window.
#[derive(Debug)]
enum Held<R> {
    Action(Box<Asked>),
    Reset(u64, R),
}

/// One client's session.
#[derive(Debug)]
pub(super) struct Session<R> {
    server: String,
    id: String,
    plan: Plan,
    times: Times,
    built: Built,
    senses: Senses,
    /// Label of the weights of the camera's features; empty without them.
    weights: String,
    phase: Phase,
    run: Option<Run>,
    window: Window,
    held: Option<Held<R>>,
    recording: recording::Recording,
    notices: Notices,
    /// Since when the client shows no token.
    client_gone: Option<Duration>,
    /// Since when the session waits for its client.
    client_silent: Duration,
    /// What happened between two rows.
    events: Vec<Event>,
    /// Refused actions that are not among the events any more.
    refused: u64,
}

/// Events between two rows that are recorded one by one.
const MAX_EVENTS: usize = 16;

impl<R> Session<R> {
    pub fn new(
        server: &str,
        id: &str,
        plan: Plan,
        times: Times,
        built: Built,
        network: Option<ResNet18>,
        now: Duration,
    ) -> Self {
        let weights = network.as_ref().map(|network| network.label().to_owned()).unwrap_or_default();
        Self {
            server: server.into(),
            id: id.into(),
            senses: Senses::new(plan.sensors.all(), plan.image_size, network),
            weights,
            plan,
            times,
            built,
            phase: Phase::Open,
            run: None,
            window: Window::default(),
            held: None,
            recording: recording::Recording::default(),
            notices: Notices::default(),
            client_gone: Some(now),
            client_silent: now,
            events: Vec::new(),
            refused: 0,
        }
    }

    /// What the client is told of it.
    pub fn info(&self) -> SessionInfo {
        info::session(&self.server, &self.id, &self.plan, self.labels(), &self.built.scene, &self.times)
    }

    fn labels(&self) -> info::Labels<'_> {
        info::Labels { weights: &self.weights, meshes: self.built.meshes() }
    }

    /// Nothing is lost when the server stops now.
    pub fn is_settled(&self) -> bool {
        let draining = matches!(self.phase, Phase::Draining(_)) && !self.plan.recorded && !self.recording.registered;
        self.phase == Phase::Done || draining
    }

    /// Takes one input, then whatever the time has brought.
    pub fn handle(&mut self, input: Input<R>, now: Duration, out: Sink<'_, R>) {
        match input {
            Input::Action(bytes) => self.on_action(&bytes, now, out),
            Input::Reset(bytes, to) => self.on_reset(&bytes, to, now, out),
            Input::Close(bytes, to) => self.on_close(&bytes, to, now, out),
            Input::Observation(to) => match &self.run {
                Some(run) => out(Output::Reply(to, "Observation", vec![run.observation.clone()])),
                None => refuse(to, &refusal(RefusalCode::Value, "", "no episode runs; send reset"), out),
            },
            Input::Look(bytes, to) => {
                let seen = self.on_look(&bytes);
                looked(to, seen, out);
            }
            Input::ClientSeen => self.client_gone = None,
            Input::ClientGone => self.client_gone = self.client_gone.or(Some(now)),
            Input::Ack(bytes) => self.on_ack(&bytes, now, out),
            Input::StepRecords(bytes, to) => self.on_truths(&bytes, to, out),
            Input::PassedOver(count) => {
                let message = format!("{count} messages found {} others waiting", limits::MAX_WAITING_MESSAGES);
                let remedy = "send one action for each observation, and the same one again after resend_s";
                self.notify(NoticeCode::Rate, count, "", message, remedy, now, out);
            }
            Input::TooLarge(length) => {
                let message = format!("a message of {length} bytes; the limit is {}", limits::MAX_CLIENT_MESSAGE);
                self.notify(NoticeCode::Size, 1, "", message, "send one action a message", now, out);
            }
            Input::Tick => {}
            Input::Shutdown => self.close("the server shuts down", now, out),
            #[cfg(test)]
            Input::Panic => panic!("a test asked for it"),
        }
        self.pass_time(now, out);
    }

    /// When the session wants to be shown the time.
    pub fn wake_at(&self) -> Option<Duration> {
        let times = &self.times;
        let mut wake = self.notices.wake_at();
        let mut at = |time: Option<Duration>| wake = wake.into_iter().chain(time).min();
        match self.phase {
            Phase::Done => return None,
            Phase::Draining(_) => at(self.drained_at()),
            Phase::Open => {
                at(self.client_gone.map(|since| since + times.grace));
                at(self.recording.waiting_since.map(|since| since + times.recorder_timeout));
                if self.held.is_none() {
                    at(Some(self.client_silent + times.action_timeout));
                }
                at(self.run.as_ref().and_then(|run| run.clock.as_ref()).map(|clock| clock.next_step));
            }
        }
        wake
    }

    fn pass_time(&mut self, now: Duration, out: Sink<'_, R>) {
        if let Some(notice) = self.notices.due(now) {
            out(Output::Notice(notice.encode_to_vec().into()));
        }
        if self.phase == Phase::Open {
            self.step_by_the_clock(now, out);
            self.stop_waiting_for_recorder(now, out);
            if self.client_gone.is_some_and(|since| now >= since + self.times.grace) {
                let secs = self.times.grace.as_secs_f64();
                self.close(&format!("the client has shown no liveliness token for {secs} s"), now, out);
            } else if self.held.is_none() && now >= self.client_silent + self.times.action_timeout {
                let secs = self.times.action_timeout.as_secs_f64();
                self.close(&format!("no action has come for {secs} s"), now, out);
            }
        }
        if matches!(self.phase, Phase::Draining(_)) && self.drained_at().is_none_or(|at| now >= at) {
            self.phase = Phase::Done;
            self.run = None;
            out(Output::Done);
        }
    }

    fn on_reset(&mut self, bytes: &ZBytes, to: R, now: Duration, out: Sink<'_, R>) {
        let request: ResetRequest = match decode(&bytes.to_bytes(), limits::MAX_CLIENT_MESSAGE) {
            Ok(request) => request,
            Err(error) => return reset_refused(to, malformed(&error), out),
        };
        if self.phase != Phase::Open {
            return reset_refused(to, closed(), out);
        }
        if let Some(run) = &self.run
            && run.index() == request.episode
            && run.step() == 0
            && run.clock.is_none()
            && self.held.is_none()
        {
            self.client_silent = now;
            let again = Observation::decode(run.observation.to_bytes().as_ref()).unwrap_or_default();
            return reset_replied(to, again, out);
        }
        if let Some(Held::Reset(_, other)) = self.held.take() {
            reset_refused(other, refusal(RefusalCode::Value, "", "another reset has come since"), out);
        }
        if self.must_wait(now) {
            self.held = Some(Held::Reset(request.episode, to));
        } else {
            self.reset(request.episode, to, now, out);
        }
    }

    fn reset(&mut self, index: u64, to: R, now: Duration, out: Sink<'_, R>) {
        self.client_silent = now;
        self.abort("another episode was asked for", now, out);
        let spec = self.plan.episode(index);
        let scene = self.built.with_friction(spec.drawn_hand_friction().map(|friction| friction.dynamic_friction));
        let scene = scene.map_err(|error| in_full(&error));
        let started = scene.and_then(|scene| Episode::start(scene, &spec).map_err(|error| in_full(&error)));
        let episode = match started {
            Ok(episode) => episode,
            Err(error) => return reset_refused(to, refusal(RefusalCode::Start, "", error), out),
        };
        let built = &self.built;
        let has_recorder = self.has_recorder();
        let (senses, sensors) = (&mut self.senses, &self.plan.sensors);
        let first = senses
            .begin(episode.scene(), || built.visuals(), Lighting::of(&spec.light()))
            .and_then(|()| observe(senses, &episode, sensors.due(0)))
            .and_then(|first| Ok((first.clone(), recorded(senses, &episode, sensors, has_recorder, first)?)));
        let (observation, seen) = match first {
            Ok(first) => first,
            Err(error) => return reset_refused(to, refusal(RefusalCode::Start, "sensors", in_full(&error)), out),
        };
        let bytes = observation.encode_to_vec();
        reset_replied(to, observation, out);
        let header = info::header(&self.server, &self.id, &self.plan, self.labels(), &episode);
        self.events.clear();
        self.refused = 0;
        let (record, truth) = Record::start(&episode, header, self.built.shapes.to_vec(), seen);
        let missed = record::Missed::default();
        self.run = Some(Run { episode, record, observation: bytes.into(), observed_at: now, clock: None, missed });
        self.publish_truth(truth, now, out);
    }

    fn on_close(&mut self, bytes: &ZBytes, to: R, now: Duration, out: Sink<'_, R>) {
        let reply = match decode::<CloseRequest>(&bytes.to_bytes(), limits::MAX_CLIENT_MESSAGE) {
            Err(error) => CloseReply { refusal: Some(malformed(&error)) },
            Ok(_) if self.phase != Phase::Open => CloseReply { refusal: Some(closed()) },
            Ok(_) => {
                self.shut("the client closed the session", now, out);
                CloseReply::default()
            }
        };
        out(Output::Reply(to, "CloseReply", vec![reply.encode_to_vec().into()]));
    }

    /// Closes for a reason that the client did not give.
    pub fn close(&mut self, why: &str, now: Duration, out: Sink<'_, R>) {
        if self.phase == Phase::Open {
            self.notify(NoticeCode::Lost, 1, "", format!("the session is closed: {why}"), "open another one", now, out);
            self.shut(why, now, out);
        }
    }

    fn shut(&mut self, why: &str, now: Duration, out: Sink<'_, R>) {
        if let Some(Held::Reset(_, to)) = self.held.take() {
            reset_refused(to, closed(), out);
        }
        self.abort(why, now, out);
        self.phase = Phase::Draining(now);
        out(Output::Closed);
    }

    /// Ends the episode that runs without a last row.
    fn abort(&mut self, why: &str, now: Duration, out: Sink<'_, R>) {
        if let Some(run) = self.run.take()
            && !run.is_over()
        {
            let events = self.take_events(run.step());
            self.publish_truth(record::aborted(&run.episode, why, events, run.missed), now, out);
        }
    }

    fn notify(
        &mut self,
        code: NoticeCode,
        count: u64,
        field: &str,
        message: String,
        remedy: &str,
        now: Duration,
        out: Sink<'_, R>,
    ) {
        let (episode, step) = self.run.as_ref().map_or((0, 0), |run| (run.index(), run.step()));
        let (field, remedy) = (field.to_owned(), remedy.to_owned());
        let notice = Notice { code: code.into(), episode, step, field, message, remedy, count };
        if let Some(notice) = self.notices.offer(notice, now) {
            out(Output::Notice(notice.encode_to_vec().into()));
        }
    }

    /// Notes what happened between two rows.
    fn note(&mut self, kind: &str, subject: &str, detail: String) {
        if self.run.as_ref().is_none_or(Run::is_over) {
            return;
        }
        if self.events.len() < MAX_EVENTS {
            let event = Event { kind: kind.into(), subject: subject.into(), detail, ..Event::default() };
            self.events.push(event);
        } else {
            self.refused += 1;
        }
    }

    /// What was noted, for the record of that step.
    fn take_events(&mut self, step: u64) -> impl Iterator<Item = Event> + use<R> {
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
