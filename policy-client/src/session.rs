//! A client's side of a session as a state machine: messages and the time go in, messages come out. It reads no clock and
//! does no I/O; the rules are those of `proto/PROTOCOL.md`.

mod check;
mod failure;
#[cfg(test)]
mod tests;

use std::collections::VecDeque;

use fiatlux_proto::limits::{MAX_SERVER_MESSAGE, RECORDER_TIMEOUT_S};
use fiatlux_proto::v3::notice::Code;
use fiatlux_proto::v3::{
    Action, EpisodeEnd, Mode, Notice, Observation, Refusal, ResetReply, ResetRequest, SessionInfo, reset_reply,
};
use fiatlux_proto::{Message, decode};

use crate::{Command, PolicyError};
use check::Lengths;
pub use failure::SessionFailure;

/// Longest time between two tries, s.
const LONGEST_WAIT_S: f64 = 1.0;

/// A query that nobody has answered for so long is asked again, s. No two are under way at once: a reset that came late
/// would abort the episode that the earlier one started.
const QUERY_TIMEOUT_S: f64 = 16.0;

/// So many refusals of one action, or messages that cannot be read, without an observation between them are no accident.
const MAX_REFUSALS: u32 = 3;

/// Each so many tries the last observation is asked for too.
const ASK_EVERY: u32 = 4;

/// What the session wants done.
#[derive(Debug, Clone, PartialEq)]
pub enum Output {
    /// Query `reset` with this [`ResetRequest`].
    Reset(Vec<u8>),
    /// Publish this [`Action`].
    Action(Vec<u8>),
    /// Query `observation`.
    AskObservation,
    /// The episode has ended.
    Done(EpisodeEnd),
    /// The session cannot go on.
    Failed(SessionFailure),
}

#[derive(Debug, Default)]
enum Phase {
    /// No episode runs.
    #[default]
    Idle,
    /// `reset` is asked; the query is out until then, or the next one waits for then.
    Resetting { out: bool, until_s: f64 },
    /// The policy has to answer this.
    Acting(Box<Observation>),
    /// The action of that step is out.
    Waiting { step: u64, action: Vec<u8>, again_s: f64 },
}

/// One client's session.
#[derive(Debug)]
pub struct ClientSession {
    server: String,
    lengths: Lengths,
    real_time: bool,
    resend_s: f64,
    silence_s: f64,
    episode: u64,
    phase: Phase,
    outputs: VecDeque<Output>,
    /// Since when nothing has come forward.
    since_s: f64,
    /// Wait before the next try.
    wait_s: f64,
    tries: u32,
    refusals: u32,
    /// Query `observation` is out.
    asking: bool,
    /// The server's words that the session, or its recording, is lost.
    lost: Option<SessionFailure>,
    /// The last thing that went wrong, to explain a silence with.
    problem: Option<String>,
    /// When the action went out first, and how long its observation took.
    sent_s: f64,
    round_trip_s: Option<f64>,
}

impl ClientSession {
    /// Of a session as the server described it.
    pub fn new(info: &SessionInfo) -> Self {
        let resend_s = if info.resend_s.is_finite() { info.resend_s.clamp(0.01, 10.0) } else { LONGEST_WAIT_S };
        let grace_s = if info.grace_s.is_finite() { info.grace_s.clamp(0.0, 3600.0) } else { 0.0 };
        Self {
            server: info.server.clone(),
            lengths: Lengths::new(info),
            real_time: info.mode() == Mode::RealTime,
            resend_s,
            // A server that waits for its recorder is silent for so long, and is no dead one.
            silence_s: grace_s.max(2.0 * RECORDER_TIMEOUT_S),
            episode: 0,
            phase: Phase::Idle,
            outputs: VecDeque::new(),
            since_s: 0.0,
            wait_s: resend_s,
            tries: 0,
            refusals: 0,
            asking: false,
            lost: None,
            problem: None,
            sent_s: 0.0,
            round_trip_s: None,
        }
    }

    /// Starts an episode; one that runs is given up. Times are in seconds from any origin.
    pub fn start(&mut self, episode: u64, now_s: f64) {
        self.episode = episode;
        self.outputs.clear();
        (self.asking, self.lost, self.problem) = (false, None, None);
        self.came_forward(now_s);
        self.ask_reset(now_s);
    }

    /// What is to be done next. [`Output::Done`] and [`Output::Failed`] are the last of an episode.
    pub fn poll(&mut self) -> Option<Output> {
        self.outputs.pop_front()
    }

    /// The observation that the policy has to answer, if there is one.
    pub fn to_answer(&self) -> Option<&Observation> {
        match &self.phase {
            Phase::Acting(observation) => Some(observation),
            _ => None,
        }
    }

    /// Time between the last action and its observation, s; `None` until the next one is there.
    pub fn take_round_trip_s(&mut self) -> Option<f64> {
        self.round_trip_s.take()
    }

    /// When [`ClientSession::tick`] has something to do.
    pub fn wake_s(&self) -> Option<f64> {
        match self.phase {
            Phase::Idle | Phase::Acting(_) => None,
            Phase::Resetting { until_s: at_s, .. } | Phase::Waiting { again_s: at_s, .. } => Some(at_s),
        }
    }

    /// The policy's answer to [`ClientSession::to_answer`].
    ///
    /// # Errors
    /// A command that no server takes; nothing is sent then.
    pub fn act(&mut self, policy: &str, command: Command, now_s: f64) -> Result<(), PolicyError> {
        let Phase::Acting(observation) = &self.phase else { return Ok(()) };
        let step = observation.step;
        check::command(policy, &command, self.lengths.joints, step)?;
        let mut action = Action { episode: self.episode, step, ..Action::default() };
        match command {
            Command::Action(numbers) => action.action = numbers,
            Command::JointTarget(numbers) => action.joint_target = numbers,
        }
        let action = action.encode_to_vec();
        self.outputs.push_back(Output::Action(action.clone()));
        self.came_forward(now_s);
        self.sent_s = now_s;
        self.phase = Phase::Waiting { step, action, again_s: now_s + self.wait_s };
        if self.lost.is_some() {
            self.ask_observation();
        }
        Ok(())
    }

    /// A message came on `observation`, published or as the answer to a query.
    pub fn observation(&mut self, bytes: &[u8], now_s: f64) {
        let read = decode::<Observation>(bytes, MAX_SERVER_MESSAGE).map_err(|error| error.to_string());
        match read.and_then(|observation| self.lengths.check(observation)) {
            Ok(observation) => self.observed(observation, now_s),
            Err(reason) => self.unreadable("observation", reason),
        }
    }

    /// Passes an observation on whose terms have the session's lengths; otherwise what is wrong.
    pub fn check(&self, observation: Observation) -> Result<Observation, String> {
        self.lengths.check(observation)
    }

    /// The query `observation` has ended: with an error reply, or with nothing.
    pub fn observation_refused(&mut self, error: Option<&[u8]>) {
        self.asking = false;
        if !matches!(self.phase, Phase::Waiting { .. }) {
            return;
        }
        if let Some(lost) = self.lost.take() {
            self.fail(lost);
        } else if let Some(refusal) = error.and_then(|bytes| decode::<Refusal>(bytes, MAX_SERVER_MESSAGE).ok()) {
            self.fail(SessionFailure::Lost { message: refusal.message, remedy: "start the episode again".into() });
        }
    }

    /// The query `observation` has been answered.
    pub fn observation_answered(&mut self) {
        self.asking = false;
    }

    /// The reply to `reset`.
    pub fn reset_reply(&mut self, bytes: &[u8], now_s: f64) {
        let reply = match decode::<ResetReply>(bytes, MAX_SERVER_MESSAGE) {
            Ok(reply) => reply.reply,
            Err(error) => return self.unreadable("reply to reset", error.to_string()),
        };
        if !matches!(self.phase, Phase::Resetting { .. }) {
            return;
        }
        match reply {
            Some(reset_reply::Reply::Observation(observation)) => {
                match self.lengths.check(observation) {
                    Ok(first) if first.episode == self.episode && first.step == 0 => self.accept(first, now_s),
                    // The answer to an earlier reset.
                    Ok(_) => {}
                    Err(reason) => self.unreadable("reply to reset", reason),
                }
            }
            Some(reset_reply::Reply::Refusal(refusal)) => {
                self.fail(SessionFailure::Reset { episode: self.episode, message: refusal.message });
            }
            None => self.unreadable("reply to reset", "it is empty".into()),
        }
    }

    /// The query `reset` has ended without a reply that could be read.
    pub fn reset_unanswered(&mut self, now_s: f64) {
        if let Phase::Resetting { out: out @ true, until_s } = &mut self.phase {
            *out = false;
            *until_s = now_s + self.wait_s;
            self.wait_s = (2.0 * self.wait_s).min(LONGEST_WAIT_S);
        }
    }

    /// A message came on `notice`.
    pub fn notice(&mut self, bytes: &[u8]) {
        let notice = match decode::<Notice>(bytes, MAX_SERVER_MESSAGE) {
            Ok(notice) => notice,
            Err(error) => return self.unreadable("notice", error.to_string()),
        };
        match notice.code() {
            Code::Lost => {
                // The recording alone may be lost. Asking tells.
                self.problem = Some(notice.message.clone());
                self.lost = Some(SessionFailure::Lost { message: notice.message, remedy: notice.remedy });
                if matches!(self.phase, Phase::Waiting { .. }) {
                    self.ask_observation();
                }
            }
            Code::Malformed | Code::Size | Code::Value | Code::Step => self.refused(notice),
            Code::Rate | Code::Unspecified => self.problem = Some(notice.message),
        }
    }

    /// Time passes.
    pub fn tick(&mut self, now_s: f64) {
        if self.wake_s().is_none_or(|at_s| now_s < at_s) {
            return;
        }
        if now_s - self.since_s >= self.silence_s {
            return self.fail(self.silent());
        }
        self.tries += 1;
        self.wait_s = (2.0 * self.wait_s).min(LONGEST_WAIT_S.max(self.resend_s));
        match &mut self.phase {
            Phase::Resetting { .. } => self.ask_reset(now_s),
            Phase::Waiting { step, action, again_s } => {
                *again_s = now_s + self.wait_s;
                // Once the clock runs, an action that comes again only comes late.
                let send = !self.real_time || *step == 0;
                if send {
                    self.outputs.push_back(Output::Action(action.clone()));
                }
                if !send || self.tries.is_multiple_of(ASK_EVERY) {
                    self.ask_observation();
                }
            }
            Phase::Idle | Phase::Acting(_) => {}
        }
    }

    fn observed(&mut self, observation: Observation, now_s: f64) {
        if observation.episode != self.episode {
            return;
        }
        match &self.phase {
            // Others are old or come twice.
            Phase::Waiting { step, .. } if observation.step > *step => {
                if !self.real_time && observation.step != step + 1 {
                    let (expected, found) = (step + 1, observation.step);
                    return self.fail(SessionFailure::Order { expected, found });
                }
                self.round_trip_s = Some(now_s - self.sent_s);
                self.accept(observation, now_s);
            }
            // In real time the newest one counts.
            Phase::Acting(present) if self.real_time && observation.step > present.step => {
                self.accept(observation, now_s);
            }
            // The server answers: it is there, and its session too.
            Phase::Waiting { .. } => self.lost = None,
            _ => {}
        }
    }

    fn accept(&mut self, mut observation: Observation, now_s: f64) {
        self.came_forward(now_s);
        self.lost = None;
        match observation.end.take() {
            Some(end) => {
                self.phase = Phase::Idle;
                self.outputs.push_back(Output::Done(end));
            }
            None => self.phase = Phase::Acting(Box::new(observation)),
        }
    }

    fn ask_reset(&mut self, now_s: f64) {
        self.outputs.push_back(Output::Reset(ResetRequest { episode: self.episode }.encode_to_vec()));
        self.phase = Phase::Resetting { out: true, until_s: now_s + QUERY_TIMEOUT_S };
    }

    fn ask_observation(&mut self) {
        if !std::mem::replace(&mut self.asking, true) {
            self.outputs.push_back(Output::AskObservation);
        }
    }

    /// The server refused an action, its present step being the notice's. One refusal may be of an old copy, or of what
    /// someone else sent; the same action refused again and again is ours.
    fn refused(&mut self, notice: Notice) {
        let Phase::Waiting { step, .. } = self.phase else { return };
        if notice.episode != self.episode {
            return;
        }
        self.refusals += 1;
        self.problem = Some(notice.message.clone());
        if self.refusals >= MAX_REFUSALS {
            let Notice { field, message, remedy, .. } = notice;
            self.fail(SessionFailure::Action { step, field, message, remedy });
        }
    }

    fn unreadable(&mut self, what: &'static str, reason: String) {
        self.refusals += 1;
        self.problem = Some(format!("a message could not be read: {reason}"));
        if self.refusals >= MAX_REFUSALS && !matches!(self.phase, Phase::Idle) {
            self.fail(SessionFailure::Unreadable { what, reason });
        }
    }

    fn silent(&self) -> SessionFailure {
        let waited_for = match &self.phase {
            Phase::Waiting { step, .. } => format!("action {step} of episode {}", self.episode),
            _ => format!("the reset to episode {}", self.episode),
        };
        SessionFailure::Silent {
            server: self.server.clone(),
            waited_for,
            silence_s: self.silence_s,
            tries: self.tries + 1,
            problem: self.problem.as_ref().map_or_else(String::new, |problem| format!("; last: {problem}")),
        }
    }

    fn fail(&mut self, failure: SessionFailure) {
        self.phase = Phase::Idle;
        self.outputs.push_back(Output::Failed(failure));
    }

    fn came_forward(&mut self, now_s: f64) {
        self.since_s = now_s;
        self.wait_s = self.resend_s;
        (self.tries, self.refusals) = (0, 0);
    }
}
