//! From actions to observations: in lockstep, and by the clock.

use std::time::Duration;

use fiatlux_link::in_full;
use fiatlux_proto::v3::notice::Code as NoticeCode;
use fiatlux_proto::v3::{Action, ActionRecord};
use fiatlux_proto::{DecodeError, Message, decode, limits};
use fiatlux_rules::CONTROL_DT;
use fiatlux_world::Command;
use zenoh::bytes::ZBytes;

use super::look::{observe, recorded};
use super::{Held, Output, Phase, Run, Session, Sink};

/// A control step by the wall clock.
const PERIOD: Duration = Duration::from_nanos((CONTROL_DT * 1e9) as u64);
/// Control steps that an action of a real-time session may be ahead: one second.
const MAX_AHEAD: u64 = 50;

/// An action, and what it asks of the robot.
#[derive(Debug, Clone)]
pub(super) struct Asked {
    action: Action,
    received: Duration,
}

/// Steps by the wall clock.
#[derive(Debug)]
pub(super) struct Clock {
    pub next_step: Duration,
    /// The newest action, for the next step.
    newest: Option<Asked>,
    /// The action that holds.
    last: Asked,
}

/// How an action came to its step.
#[derive(Debug, Clone, Copy, Default)]
struct Arrival {
    held: bool,
    lateness_s: f64,
}

impl<R> Session<R> {
    pub(super) fn on_action(&mut self, bytes: &ZBytes, now: Duration, out: Sink<'_, R>) {
        let action: Action = match decode(&bytes.to_bytes(), limits::MAX_CLIENT_MESSAGE) {
            Ok(action) => action,
            Err(error) => {
                let code = match error {
                    DecodeError::Size { .. } => NoticeCode::Size,
                    _ => NoticeCode::Malformed,
                };
                return self.refuse_action(code, "", error.to_string(), "send a fiatlux.v3.Action", now, out);
            }
        };
        let Some(run) = &self.run else {
            let (message, remedy) = match self.phase {
                Phase::Open => ("no episode runs", "send reset"),
                _ => ("the session is closed", "open another one"),
            };
            return self.refuse_action(NoticeCode::Step, "episode", message.into(), remedy, now, out);
        };
        if action.episode != run.index() {
            let message = format!("an action of episode {}; episode {} runs", action.episode, run.index());
            return self.refuse_action(NoticeCode::Step, "episode", message, "answer the last observation", now, out);
        }
        if self.plan.real_time {
            self.take_for_the_clock(action, now, out);
        } else {
            self.take_in_lockstep(action, now, out);
        }
    }

    fn take_in_lockstep(&mut self, action: Action, now: Duration, out: Sink<'_, R>) {
        let Some(run) = &self.run else { return };
        let present = run.step();
        if action.step.checked_add(1) == Some(present) {
            // The client has not seen the present observation.
            return out(Output::Observation(run.observation.clone()));
        }
        if self.refuse_step(&action, action.step == present, now, out) {
            return;
        }
        // The same action again, while it waits for the recorder.
        if matches!(self.held, Some(Held::Action(_))) {
            return;
        }
        let Some(asked) = self.read_command(action, now, out) else { return };
        if self.must_wait(now) {
            self.held = Some(Held::Action(Box::new(asked)));
        } else {
            self.advance(asked, Arrival::default(), now, out);
        }
    }

    fn take_for_the_clock(&mut self, action: Action, now: Duration, out: Sink<'_, R>) {
        let Some(run) = &self.run else { return };
        let ahead = action.step.checked_sub(run.step());
        if self.refuse_step(&action, ahead.is_some_and(|steps| steps < MAX_AHEAD), now, out) {
            return;
        }
        let Some(asked) = self.read_command(action, now, out) else { return };
        self.client_silent = now;
        let Some(run) = &mut self.run else { return };
        match &mut run.clock {
            None => run.clock = Some(Clock { next_step: now, newest: Some(asked.clone()), last: asked }),
            Some(clock) => {
                if clock.newest.as_ref().is_none_or(|newest| newest.action.step <= asked.action.step) {
                    clock.newest = Some(asked);
                }
            }
        }
    }

    /// Refuses an action whose step does not fit, or that follows the end.
    fn refuse_step(&mut self, action: &Action, fits: bool, now: Duration, out: Sink<'_, R>) -> bool {
        let Some(run) = &self.run else { return true };
        if fits && !run.is_over() {
            return false;
        }
        let (step, present) = (action.step, run.step());
        let (message, remedy) = if run.is_over() {
            (format!("an action of step {step}; the episode ended at step {present}"), "send reset or close")
        } else if step < present {
            (format!("an action of step {step}; step {present} is present"), "answer the last observation in time")
        } else {
            (format!("an action of step {step}; step {present} is present"), "answer the last observation")
        };
        self.refuse_action(NoticeCode::Step, "step", message, remedy, now, out);
        true
    }

    /// What an action asks of the robot, or a notice.
    fn read_command(&mut self, action: Action, now: Duration, out: Sink<'_, R>) -> Option<Asked> {
        let remedy = "fill one of action and joint_target with a finite number for each joint";
        let (field, numbers) = match (action.action.is_empty(), action.joint_target.is_empty()) {
            (false, true) => ("action", &action.action),
            (true, false) => ("joint_target", &action.joint_target),
            (both, _) => {
                let what = if both { "neither action nor joint_target is" } else { "both action and joint_target are" };
                self.refuse_action(NoticeCode::Value, "action", format!("{what} filled"), remedy, now, out);
                return None;
            }
        };
        let robot = &self.built.scene.robot;
        let joints = robot.joints().len();
        if numbers.len() != joints {
            let message = format!("{field} has {} numbers instead of {joints}", numbers.len());
            self.refuse_action(NoticeCode::Value, field, message, remedy, now, out);
            return None;
        }
        let mut in_action_units = Vec::new();
        command_of(&action).write_action(robot.q0(), &mut in_action_units);
        if let Some(joint) = in_action_units.iter().position(|number| !number.is_finite()) {
            let message = format!("{field} of joint '{}' is not finite", robot.joints()[joint].name);
            self.refuse_action(NoticeCode::Value, field, message, remedy, now, out);
            return None;
        }
        Some(Asked { action, received: now })
    }

    fn refuse_action(
        &mut self,
        code: NoticeCode,
        field: &str,
        message: String,
        remedy: &str,
        now: Duration,
        out: Sink<'_, R>,
    ) {
        self.note("refused", field, message.clone());
        self.notify(code, 1, field, message, remedy, now, out);
    }

    /// Goes on with an action that waited for the recorder.
    pub(super) fn advance_held(&mut self, asked: Box<Asked>, now: Duration, out: Sink<'_, R>) {
        self.advance(*asked, Arrival::default(), now, out);
    }

    fn advance(&mut self, asked: Asked, arrival: Arrival, now: Duration, out: Sink<'_, R>) {
        let Some(run) = &mut self.run else { return };
        let outside_box = match run.episode.step(command_of(&asked.action)) {
            Ok(step) => step.outside_box,
            Err(error) => {
                let message = error.to_string();
                return self.refuse_action(NoticeCode::Value, "action", message, "send finite numbers", now, out);
            }
        };
        let due = self.plan.sensors.due(run.step());
        let observation = match observe(&mut self.senses, &run.episode, due) {
            Ok(observation) => observation,
            Err(error) => return self.close(&in_full(&error), now, out),
        };
        run.observation = observation.encode_to_vec().into();
        run.observed_at = now;
        run.missed.steps += u64::from(arrival.held);
        self.client_silent = if arrival.held { self.client_silent } else { now };
        // Before the record is made: a client on another core acts meanwhile.
        out(Output::Observation(run.observation.clone()));

        let made = ActionRecord {
            action: Some(asked.action),
            outside_box,
            held: arrival.held,
            lateness_s: arrival.lateness_s,
        };
        let events = self.take_events(self.run.as_ref().map_or(0, Run::step));
        let has_recorder = self.has_recorder();
        let Some(run) = &mut self.run else { return };
        let seen = match recorded(&mut self.senses, &run.episode, &self.plan.sensors, has_recorder, observation) {
            Ok(seen) => seen,
            Err(error) => return self.close(&in_full(&error), now, out),
        };
        let truth = run.record.row(&run.episode, &made, seen, events, run.missed);
        if run.is_over() {
            run.clock = None;
        }
        self.publish_truth(truth, now, out);
    }

    /// Takes the step of a real-time session whose time has come.
    pub(super) fn step_by_the_clock(&mut self, now: Duration, out: Sink<'_, R>) {
        let Some(run) = &mut self.run else { return };
        let Some(clock) = &mut run.clock else { return };
        let Some(behind) = now.checked_sub(clock.next_step) else { return };
        clock.next_step = if behind < PERIOD { clock.next_step + PERIOD } else { now + PERIOD };
        let newest = clock.newest.take();
        let held = newest.is_none();
        if let Some(newest) = newest {
            clock.last = newest;
        }
        let asked = clock.last.clone();
        let lateness = if held { Duration::ZERO } else { asked.received.saturating_sub(run.observed_at) };
        if behind >= PERIOD {
            let message = format!("the server is {:.3} s behind the clock and goes on from now", behind.as_secs_f64());
            self.note("lost", "time", message.clone());
            self.notify(
                NoticeCode::Unspecified,
                1,
                "",
                message,
                "ask for fewer sensors or looks, or run fewer sessions on this server",
                now,
                out,
            );
        }
        self.advance(asked, Arrival { held, lateness_s: lateness.as_secs_f64() }, now, out);
    }
}

/// What a checked action asks for: one of its lists is filled.
fn command_of(action: &Action) -> Command<'_> {
    if action.action.is_empty() { Command::JointTarget(&action.joint_target) } else { Command::Action(&action.action) }
}
