//! A client's side of a session. It follows the rules in `proto/PROTOCOL.md`.

mod failure;
#[cfg(test)]
mod tests;

use std::collections::VecDeque;
use std::time::Duration;

use fiatlux_proto::limits::{MAX_SERVER_MESSAGE, MAX_WAITING_MESSAGES, RECORDER_TIMEOUT};
use fiatlux_proto::v3::notice::Code;
use fiatlux_proto::v3::{
    Chunk, EpisodeEnd, Mode, Notice, Observation, Refusal, ResetReply, ResetRequest, SessionInfo, reset_reply,
};
use fiatlux_proto::{Bytes, Message, ObservationLayout, PROTOCOL, TermError, decode, encode};

use crate::command::{Command, check_chunk};
use crate::machine::Machine;
pub use failure::SessionFailure;

/// Longest time between two tries.
const LONGEST_WAIT: Duration = Duration::from_secs(1);

/// A query without an answer is repeated after this time. Two are never under way at once: a late reset would abort the
/// episode that the earlier one started.
const QUERY_TIMEOUT: Duration = Duration::from_secs(16);

/// The client gives up after this many refusals of one action, or unreadable messages, without an observation between them.
const MAX_REFUSALS: u32 = 3;

/// Shortest time before an action is sent again, however short round trips are.
const SHORTEST_WAIT: Duration = Duration::from_millis(20);

/// Actions that a client may send ahead of their observations: half of what may wait in a session, so that all of them can
/// be sent again.
const MAX_AHEAD: usize = MAX_WAITING_MESSAGES / 2;

/// A server is gone if its token is away for this time and no message comes from it.
const AWAY: Duration = Duration::from_secs(5);

/// Silence of a server in the same process after which a client gives up, however busy the machine is.
const PATIENCE: Duration = Duration::from_secs(3600);

/// One in this many tries also asks for the last observation.
const ASK_EVERY: u32 = 4;

/// Answer to a query: a reply, an error reply, or none.
pub type Answer = Option<Result<Bytes, Bytes>>;

#[derive(Debug, Clone, PartialEq)]
pub enum Input {
    /// Start this episode; a running one is given up.
    Start(u64),
    /// The policy's answer to the last [`Output::Observation`], or for [`ClientSession::next_step`].
    Command(Command),
    /// The model's chunk that the next command comes from, for the record. Servers that cannot take it do not get it.
    Chunk(Box<Chunk>),
    /// A message on `observation`.
    Observation(Bytes),
    /// A message on `notice`.
    Notice(Bytes),
    /// The query `reset` has ended.
    Reset(Answer),
    /// The query `observation` has ended.
    LastObservation(Answer),
    /// The server's liveliness token of the session has appeared (`true`) or gone (`false`).
    ServerSeen(bool),
    /// Nothing has arrived; only time has passed.
    Tick,
}

/// Requests of a client to its caller.
#[derive(Debug, Clone, PartialEq)]
pub enum Output {
    /// Query `reset` with this [`ResetRequest`].
    Reset(Bytes),
    /// Publish this [`Action`](fiatlux_proto::v3::Action) as it is encoded.
    Action(Bytes),
    /// Query `observation`, since the last one may have been lost.
    AskObservation,
    /// Time between an action and its observation, which is the next output.
    RoundTrip(Duration),
    /// The policy has to answer this observation.
    Observation(Box<Observation>),
    /// The episode has ended; nothing follows.
    Done(EpisodeEnd),
    /// The session cannot go on; nothing follows.
    Failed(SessionFailure),
}

#[derive(Debug, Default)]
enum Phase {
    /// No episode is running; waits for [`Input::Start`].
    #[default]
    Idle,
    /// A reset is under way. `until` is when the open query ends, or when the next one is sent.
    Resetting { out: bool, until: Duration },
    /// The policy has to answer the observation of this step.
    Acting { step: u64 },
    /// The actions of this step and of the steps that follow are sent; there is at least one.
    Waiting { step: u64, actions: VecDeque<Bytes>, again: Duration },
}

/// One client's session: a state machine without I/O and without a clock.
#[derive(Debug)]
pub struct ClientSession {
    info: SessionInfo,
    layout: Result<ObservationLayout, TermError>,
    resend: Duration,
    /// A server that sends nothing for this time is gone.
    silence: Duration,
    episode: u64,
    phase: Phase,
    outputs: VecDeque<Output>,
    /// Time of the last progress.
    since: Duration,
    /// Pause before the next try.
    wait: Duration,
    tries: u32,
    refusals: u32,
    /// When the server's token went away.
    away: Option<Duration>,
    /// The query `observation` is under way.
    asking: bool,
    /// The server's message that the session, or its recording, is lost.
    lost: Option<SessionFailure>,
    /// The chunk that the next command comes from.
    chunk: Option<Chunk>,
    /// The last thing that went wrong, to explain a silence.
    problem: Option<String>,
    /// When the action was first sent.
    sent_at: Duration,
    /// Smoothed time between an action and its observation.
    round_trip: Option<Duration>,
}

impl Machine for ClientSession {
    type Input = Input;
    type Output = Output;

    fn handle(&mut self, input: Input, now: Duration) {
        match input {
            Input::Start(episode) => self.start(episode, now),
            Input::Command(command) => self.act(command, now),
            Input::Chunk(chunk) => self.chunk = Some(*chunk),
            Input::Observation(bytes) => self.on_observation(&bytes, now),
            Input::Notice(bytes) => self.on_notice(&bytes),
            Input::Reset(Some(Ok(bytes))) => self.on_reset_reply(&bytes, now),
            Input::Reset(Some(Err(_)) | None) => self.on_reset_unanswered(now),
            Input::LastObservation(answer) => {
                self.asking = false;
                match answer {
                    Some(Ok(bytes)) => self.on_observation(&bytes, now),
                    Some(Err(bytes)) => self.on_observation_refused(Some(&bytes)),
                    None => self.on_observation_refused(None),
                }
            }
            Input::ServerSeen(true) => self.away = None,
            Input::ServerSeen(false) => self.away = self.away.or(Some(now)),
            Input::Tick => {}
        }
        self.pass_time(now);
    }

    fn poll(&mut self) -> Option<Output> {
        self.outputs.pop_front()
    }

    fn wake_at(&self) -> Option<Duration> {
        match self.phase {
            Phase::Idle | Phase::Acting { .. } => None,
            Phase::Resetting { until: at, .. } | Phase::Waiting { again: at, .. } => {
                Some(self.away.map_or(at, |since| at.min(since + AWAY)))
            }
        }
    }
}

impl ClientSession {
    /// The same where no message can be lost and the server lives as long as this does: one that is slow is waited for, for an hour. Only its
    /// token says that it is gone.
    #[must_use]
    pub fn patient(self) -> Self {
        Self { silence: PATIENCE, ..self }
    }

    /// A client of the session that the server has described.
    pub fn new(info: &SessionInfo) -> Self {
        let resend = seconds(info.resend_s)
            .map_or(LONGEST_WAIT, |resend| resend.clamp(Duration::from_millis(10), Duration::from_secs(10)));
        let grace = seconds(info.grace_s).unwrap_or_default().min(Duration::from_secs(3600));
        Self {
            info: info.clone(),
            layout: ObservationLayout::new(info),
            resend,
            // A server that waits for its recorder may be silent for that long.
            silence: grace.max(2 * RECORDER_TIMEOUT),
            episode: 0,
            phase: Phase::Idle,
            outputs: VecDeque::new(),
            since: Duration::ZERO,
            wait: resend,
            tries: 0,
            refusals: 0,
            away: None,
            asking: false,
            lost: None,
            chunk: None,
            problem: None,
            sent_at: Duration::ZERO,
            round_trip: None,
        }
    }

    /// The step whose command may be given before its observation arrives; only in lockstep, for policies that need none.
    pub fn next_step(&self) -> Option<u64> {
        match &self.phase {
            Phase::Waiting { step, actions, .. } if actions.len() < MAX_AHEAD && !self.is_real_time() => {
                Some(step + actions.len() as u64)
            }
            _ => None,
        }
    }

    /// True if actions have been sent before their observations arrived.
    pub fn is_ahead(&self) -> bool {
        matches!(&self.phase, Phase::Waiting { actions, .. } if actions.len() > 1)
    }

    /// True if a notice concerns an action that was sent ahead, or twice, and needs nobody's attention: its episode is over, or
    /// the session sends again what is missing.
    pub fn is_left_over(&self, notice: &Notice) -> bool {
        let is_playing = matches!(self.phase, Phase::Waiting { .. } | Phase::Acting { .. });
        notice.code() == Code::Step && (self.is_ahead() || !is_playing || notice.episode != self.episode)
    }

    /// Returns the answer to a look if its parts are those that the session announced.
    pub fn check(&self, observation: Observation) -> Result<Observation, String> {
        let layout = self.layout.as_ref().map_err(ToString::to_string)?;
        layout.check(&observation).map_err(|error| error.to_string())?;
        Ok(observation)
    }

    fn is_real_time(&self) -> bool {
        self.info.mode() == Mode::RealTime
    }

    fn start(&mut self, episode: u64, now: Duration) {
        self.episode = episode;
        self.outputs.clear();
        (self.asking, self.lost, self.problem, self.chunk) = (false, None, None, None);
        self.came_forward(now);
        self.ask_reset(now);
    }

    fn act(&mut self, command: Command, now: Duration) {
        let ahead = self.next_step();
        let Some(step) = ahead.or(match self.phase {
            Phase::Acting { step } => Some(step),
            _ => None,
        }) else {
            return;
        };
        if let Err(error) = command.check(&self.info) {
            return self.fail(SessionFailure::command(step, &error));
        }
        let mut action = command.into_action(self.episode, step);
        let knows = |minor| self.info.protocol.is_some_and(|peer| peer.major == PROTOCOL.major && peer.minor >= minor);
        let (knows_chunks, knows_phases) = (knows(5), knows(13));
        action.chunk = self.chunk.take().filter(|chunk| knows_chunks && check_chunk(chunk).is_ok());
        if let Some(chunk) = action.chunk.as_mut().filter(|_| !knows_phases) {
            (chunk.phase, chunk.is_over) = (String::new(), None);
        }
        let action = Bytes::from(encode(&action));
        self.outputs.push_back(Output::Action(action.clone()));
        if let Phase::Waiting { actions, .. } = &mut self.phase {
            return actions.push_back(action);
        }
        self.came_forward(now);
        self.sent_at = now;
        self.phase = Phase::Waiting { step, actions: VecDeque::from([action]), again: now + self.wait };
        if self.lost.is_some() {
            self.ask_observation();
        }
    }

    fn on_observation(&mut self, bytes: &[u8], now: Duration) {
        let read = decode::<Observation>(bytes, MAX_SERVER_MESSAGE).map_err(|error| error.to_string());
        match read.and_then(|observation| self.check(observation)) {
            Ok(observation) => self.observed(observation, now),
            Err(reason) => self.unreadable("observation", reason),
        }
    }

    fn on_observation_refused(&mut self, error: Option<&[u8]>) {
        if !matches!(self.phase, Phase::Waiting { .. }) {
            return;
        }
        if let Some(lost) = self.lost.take() {
            self.fail(lost);
        } else if let Some(refusal) = error.and_then(|bytes| decode::<Refusal>(bytes, MAX_SERVER_MESSAGE).ok()) {
            self.fail(SessionFailure::Lost { message: refusal.message, remedy: "start the episode again".into() });
        }
    }

    fn on_reset_reply(&mut self, bytes: &[u8], now: Duration) {
        let reply = match decode::<ResetReply>(bytes, MAX_SERVER_MESSAGE) {
            Ok(reply) => reply.reply,
            Err(error) => return self.unreadable("reply to reset", error.to_string()),
        };
        if !matches!(self.phase, Phase::Resetting { .. }) {
            return;
        }
        match reply {
            Some(reset_reply::Reply::Observation(observation)) => {
                match self.check(observation) {
                    Ok(first) if first.episode == self.episode && first.step == 0 => self.accept(first, now),
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

    fn on_reset_unanswered(&mut self, now: Duration) {
        if let Phase::Resetting { out: out @ true, until } = &mut self.phase {
            *out = false;
            *until = now + self.wait;
            self.wait = (2 * self.wait).min(LONGEST_WAIT);
        }
    }

    fn on_notice(&mut self, bytes: &[u8]) {
        let notice = match decode::<Notice>(bytes, MAX_SERVER_MESSAGE) {
            Ok(notice) => notice,
            Err(error) => return self.unreadable("notice", error.to_string()),
        };
        match notice.code() {
            Code::Lost => {
                // Perhaps only the recording is lost. A query shows it.
                self.problem = Some(notice.message.clone());
                self.lost = Some(SessionFailure::Lost { message: notice.message, remedy: notice.remedy });
                if matches!(self.phase, Phase::Waiting { .. }) {
                    self.ask_observation();
                }
            }
            // An action was lost: those after it come too early, until it is sent again.
            Code::Step if self.is_ahead() => self.problem = Some(notice.message),
            // The server went on without an action, as it does in real time, and what it saw then is under way, was lost, or has come.
            Code::Step if self.is_real_time() || self.is_behind(&notice) => {
                self.problem = Some(notice.message);
                self.ask_observation();
            }
            Code::Malformed | Code::Size | Code::Value | Code::Step => self.refused(notice),
            Code::Rate | Code::Late | Code::Unspecified => self.problem = Some(notice.message),
        }
    }

    fn pass_time(&mut self, now: Duration) {
        if self.wake_at().is_none_or(|at| now < at) {
            return;
        }
        if self.away.is_some_and(|since| now >= since + AWAY) {
            let server = &self.info.server;
            let message = format!("server {server} is gone: its token has been away for {} s", AWAY.as_secs());
            return self.fail(SessionFailure::Lost { message, remedy: "start it again, or use another one".into() });
        }
        if now.saturating_sub(self.since) >= self.silence {
            return self.fail(self.silent());
        }
        self.tries += 1;
        self.wait = (2 * self.wait).min(LONGEST_WAIT.max(self.resend));
        let real_time = self.is_real_time();
        match &mut self.phase {
            Phase::Resetting { .. } => self.ask_reset(now),
            Phase::Waiting { step, actions, again } => {
                *again = now + self.wait;
                // Once the clock runs, a repeated action would only be late.
                let send = !real_time || *step == 0;
                if send {
                    self.outputs.extend(actions.iter().cloned().map(Output::Action));
                }
                if !send || actions.len() > 1 || self.tries.is_multiple_of(ASK_EVERY) {
                    self.ask_observation();
                }
            }
            Phase::Idle | Phase::Acting { .. } => {}
        }
    }

    fn observed(&mut self, observation: Observation, now: Duration) {
        if observation.episode != self.episode {
            return;
        }
        let real_time = self.is_real_time();
        match &mut self.phase {
            // Any other is old, or a repetition.
            Phase::Waiting { step, actions, .. } if observation.step > *step => {
                let answered = observation.step - *step;
                if !real_time && answered > actions.len() as u64 {
                    let (expected, found) = (*step + 1, observation.step);
                    return self.fail(SessionFailure::Order { expected, found });
                }
                if answered < actions.len() as u64 && observation.end.is_none() {
                    *step = observation.step;
                    actions.drain(..answered as usize);
                    return self.came_forward(now);
                }
                if actions.len() == 1 {
                    self.measure(now.saturating_sub(self.sent_at));
                }
                self.accept(observation, now);
            }
            // In real time only the newest one counts.
            Phase::Acting { step } if real_time && observation.step > *step => {
                self.accept(observation, now);
            }
            // The server answers, so the server and its session are there.
            Phase::Waiting { .. } => (self.lost, self.away) = (None, None),
            _ => {}
        }
    }

    fn accept(&mut self, mut observation: Observation, now: Duration) {
        self.came_forward(now);
        (self.lost, self.away) = (None, None);
        match observation.end.take() {
            Some(end) => {
                self.phase = Phase::Idle;
                self.outputs.push_back(Output::Done(end));
            }
            None => {
                self.phase = Phase::Acting { step: observation.step };
                self.outputs.push_back(Output::Observation(Box::new(observation)));
            }
        }
    }

    fn ask_reset(&mut self, now: Duration) {
        self.outputs.push_back(Output::Reset(ResetRequest { episode: self.episode }.encode_to_vec().into()));
        self.phase = Phase::Resetting { out: true, until: now + QUERY_TIMEOUT };
    }

    fn ask_observation(&mut self) {
        if !std::mem::replace(&mut self.asking, true) {
            self.outputs.push_back(Output::AskObservation);
        }
    }

    /// True if the server is at a later step of the episode than the client knows.
    fn is_behind(&self, notice: &Notice) -> bool {
        let Phase::Waiting { step, .. } = self.phase else { return false };
        notice.episode == self.episode && notice.step > step
    }

    fn came_forward(&mut self, now: Duration) {
        self.since = now;
        // If round trips are short, a lost message is noticed early.
        self.wait = self.round_trip.map_or(self.resend, |time| (4 * time).max(SHORTEST_WAIT).min(self.resend));
        (self.tries, self.refusals) = (0, 0);
        if let Phase::Waiting { again, .. } = &mut self.phase {
            *again = now + self.wait;
        }
    }

    /// Updates the smoothed round trip; a message that was sent again lengthens it.
    fn measure(&mut self, time: Duration) {
        self.outputs.push_back(Output::RoundTrip(time));
        if self.tries == 0 {
            self.round_trip = Some(self.round_trip.map_or(time, |known| (7 * known + time) / 8));
        }
    }
}

/// A time in a message, s; `None` if it is not a valid one.
fn seconds(secs: f64) -> Option<Duration> {
    secs.is_finite().then(|| Duration::try_from_secs_f64(secs.max(0.0)).unwrap_or(Duration::MAX))
}
