//! Turns actions into observations and records, in lockstep and in real time.

use std::time::Duration;

use fiatlux_proto::v3::notice::Code as NoticeCode;
use fiatlux_proto::v3::{Action, ActionRecord, Event};
use fiatlux_proto::{DecodeError, Message, decode, encode, limits};

use super::{Deferred, Host, Output, Phase, ServerSession};
use crate::command::Command;

/// Farthest that an action of a real-time session may be ahead of the present step.
const MAX_AHEAD: Duration = Duration::from_secs(1);

#[derive(Debug, Clone)]
pub(super) struct ReceivedAction {
    action: Action,
    command: Command,
    at: Duration,
}

/// The clock of a real-time session.
#[derive(Debug)]
pub(super) struct Clock {
    pub next_step: Duration,
    /// The newest action, which the next step uses.
    newest: Option<ReceivedAction>,
    /// The action in force, and for how many steps it has been held.
    last: ReceivedAction,
    held: u64,
}

impl ReceivedAction {
    /// Takes the velocity out of a whole-body command; returns whether there was one.
    fn stand(&mut self) -> bool {
        let Command::WholeBody(command, _) = &mut self.command else { return false };
        let velocity = std::mem::take(&mut command.velocity);
        self.action.whole_body = Some((*command).into());
        velocity.iter().any(|velocity| *velocity != 0.0)
    }
}

/// A finished step, for its record.
#[derive(Debug)]
pub(super) struct Unrecorded {
    action: ActionRecord,
    /// Events before the step.
    events: Vec<Event>,
    at: Duration,
}

/// Arrival of a step's action.
#[derive(Debug, Clone, Copy, Default)]
struct Arrival {
    held: bool,
    lateness_s: f64,
}

impl<H: Host, R> ServerSession<H, R> {
    pub(super) fn on_action(&mut self, bytes: &[u8], now: Duration) {
        let action: Action = match decode(bytes, limits::MAX_CLIENT_MESSAGE) {
            Ok(action) => action,
            Err(error) => {
                let code = match error {
                    DecodeError::Size { .. } => NoticeCode::Size,
                    _ => NoticeCode::Malformed,
                };
                return self.refuse_action(code, "", error.to_string(), "send a fiatlux.v3.Action", now);
            }
        };
        let Some(run) = &self.run else {
            let (message, remedy) = match self.phase {
                Phase::Open => ("no episode runs", "send reset"),
                _ => ("the session is closed", "open another one"),
            };
            return self.refuse_action(NoticeCode::Step, "episode", message.into(), remedy, now);
        };
        if action.episode != run.episode {
            let message = format!("an action of episode {}; episode {} runs", action.episode, run.episode);
            return self.refuse_action(NoticeCode::Step, "episode", message, "answer the last observation", now);
        }
        if self.is_real_time() {
            self.take_for_the_clock(action, now);
        } else {
            self.take_in_lockstep(action, now);
        }
    }

    fn take_in_lockstep(&mut self, action: Action, now: Duration) {
        let Some(run) = &self.run else { return };
        let present = run.step;
        if action.step.checked_add(1) == Some(present) {
            // The client has missed the present observation.
            return self.outputs.push_back(Output::Observation(run.observation.clone()));
        }
        if self.refuse_step(&action, action.step == present, now) {
            return;
        }
        // A copy of the action that waits for the recorder.
        if matches!(self.deferred, Some(Deferred::Action(_))) {
            return;
        }
        let Some(received) = self.read_command(action, now) else { return };
        if self.must_wait(now) {
            self.deferred = Some(Deferred::Action(Box::new(received)));
        } else {
            self.advance(received, Arrival::default(), now);
        }
    }

    fn take_for_the_clock(&mut self, action: Action, now: Duration) {
        let Some(run) = &self.run else { return };
        let ahead = action.step.checked_sub(run.step);
        let max_ahead = MAX_AHEAD.div_duration_f64(self.period()).round() as u64;
        if self.refuse_step(&action, ahead.is_some_and(|steps| steps < max_ahead), now) {
            return;
        }
        let Some(received) = self.read_command(action, now) else { return };
        self.client_silent = now;
        let Some(run) = &mut self.run else { return };
        match &mut run.clock {
            None => run.clock = Some(Clock { next_step: now, newest: Some(received.clone()), last: received, held: 0 }),
            Some(clock) => {
                if clock.newest.as_ref().is_none_or(|newest| newest.action.step <= received.action.step) {
                    clock.newest = Some(received);
                }
            }
        }
    }

    /// Refuses an action of a wrong step, or after the end of the episode.
    fn refuse_step(&mut self, action: &Action, fits: bool, now: Duration) -> bool {
        let Some(run) = &self.run else { return true };
        if fits && !run.is_over {
            return false;
        }
        let (step, present) = (action.step, run.step);
        let (message, remedy) = if run.is_over {
            (format!("an action of step {step}; the episode ended at step {present}"), "send reset or close")
        } else if step < present {
            (format!("an action of step {step}; the present step is {present}"), "answer the last observation in time")
        } else {
            (format!("an action of step {step}; the present step is {present}"), "answer the last observation")
        };
        self.refuse_action(NoticeCode::Step, "step", message, remedy, now);
        true
    }

    /// The command of an action; a wrong one is answered with a notice.
    fn read_command(&mut self, action: Action, now: Duration) -> Option<ReceivedAction> {
        match Command::of(&action, &self.info) {
            Ok(command) => Some(ReceivedAction { action, command, at: now }),
            Err(error) => {
                self.refuse_action(NoticeCode::Value, error.field(), error.to_string(), error.remedy(), now);
                None
            }
        }
    }

    fn refuse_action(&mut self, code: NoticeCode, field: &str, message: String, remedy: &str, now: Duration) {
        self.note("refused", field, message.clone());
        self.notify(code, 1, field, message, remedy, now);
    }

    /// Continues with an action that waited for the recorder.
    pub(super) fn advance_deferred(&mut self, received: ReceivedAction, now: Duration) {
        self.advance(received, Arrival::default(), now);
    }

    fn advance(&mut self, received: ReceivedAction, arrival: Arrival, now: Duration) {
        let Some(run) = &mut self.run else { return };
        let observation = match self.host.step(&received.command) {
            Ok(observation) => observation,
            Err(refusal) => return self.terminate(&refusal.message, now),
        };
        (run.step, run.is_over) = (observation.step, observation.end.is_some());
        run.observation = encode(observation).into();
        run.observed_at = now;
        run.missed_steps += u64::from(arrival.held);
        if run.is_over {
            run.clock = None;
        }
        self.outputs.push_back(Output::Observation(run.observation.clone()));
        let step = run.step;
        self.client_silent = if arrival.held { self.client_silent } else { now };
        let action = ActionRecord {
            action: Some(received.action),
            outside_box: false,
            held: arrival.held,
            lateness_s: arrival.lateness_s,
        };
        self.unrecorded = Some(Unrecorded { action, events: self.take_events(step).collect(), at: now });
    }

    /// Makes the record of the last step.
    pub(super) fn record_step(&mut self) {
        let Some(Unrecorded { action, events, at }) = self.unrecorded.take() else { return };
        let large = self.has_recorder();
        match self.host.record(Some(action), large) {
            Ok(mut record) => {
                record.events.splice(0..0, events.iter().map(Message::encode_to_vec));
                if let (Some(result), Some(run)) = (&mut record.result, &self.run) {
                    result.missed_steps = run.missed_steps;
                    self.host.sign(result);
                }
                self.publish_record(record, at);
            }
            Err(refusal) => {
                self.terminate(&refusal.message, at);
                self.finish_draining(at);
            }
        }
    }

    /// Takes the step of a real-time session that is due.
    pub(super) fn step_by_the_clock(&mut self, now: Duration) {
        let period = self.period();
        let command_steps = (self.info.command_timeout_s / self.info.control_dt).round() as u64;
        let Some(run) = &mut self.run else { return };
        let Some(clock) = &mut run.clock else { return };
        let Some(behind) = now.checked_sub(clock.next_step) else { return };
        clock.next_step = if behind < period { clock.next_step + period } else { now + period };
        let newest = clock.newest.take();
        let held = newest.is_none();
        clock.held = if held { clock.held + 1 } else { 0 };
        if let Some(newest) = newest {
            clock.last = newest;
        }
        // A client that falls silent must not send the robot into a wall.
        let is_expired = command_steps > 0 && clock.held >= command_steps && clock.last.stand();
        let received = clock.last.clone();
        let lateness = if held { Duration::ZERO } else { received.at.saturating_sub(run.observed_at) };
        if is_expired {
            let message = format!("no action has come for {} s; the robot stands", self.info.command_timeout_s);
            self.note("expired", "whole_body", message.clone());
            let remedy = "send an action in every step, or open the session with a longer command_timeout_ms";
            self.notify(NoticeCode::Late, 1, "whole_body", message, remedy, now);
        }
        if behind >= period {
            let message =
                format!("the server is {:.3} s behind the clock and continues from now", behind.as_secs_f64());
            self.note("lost", "time", message.clone());
            let remedy = "ask for fewer sensors or looks, or run fewer sessions on this server";
            self.notify(NoticeCode::Late, 1, "", message, remedy, now);
        }
        self.advance(received, Arrival { held, lateness_s: lateness.as_secs_f64() }, now);
    }

    /// Duration of a control step on the wall clock, at least a millisecond.
    fn period(&self) -> Duration {
        Duration::try_from_secs_f64(self.info.control_dt).unwrap_or_default().max(Duration::from_millis(1))
    }
}
