//! A client on a carrier: finds a server, opens a session on it, and carries messages between the server and a
//! [`ClientSession`].

mod access;
mod discover;
mod error;
mod mailbox;
pub(crate) mod query;
mod subscriptions;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::Sender;
use std::time::{Duration, Instant};

use fiatlux_access::{Channel, RowsKey, Secrets, Side};
use fiatlux_carrier::{BusyWait, Carrier, Declaration, Priority, Publisher, Quality, Reach};
use fiatlux_proto::keys::{ServerKeys, SessionKeys, is_name};
use fiatlux_proto::limits::MAX_SERVER_MESSAGE;
use fiatlux_proto::v3::refusal::Code;
use fiatlux_proto::v3::{
    CloseReply, CloseRequest, EpisodeEnd, LookReply, LookRequest, Mode, Notice, Observation, OpenReply, OpenRequest,
    ResetReply, ResetRequest, SessionInfo, look_reply, open_reply, reset_reply,
};
use fiatlux_proto::{Bytes, Message as _, ObservationLayout, PROTOCOL, decode, is_compatible, plain};
use fiatlux_session::client::{Answer, Input, Output};
use fiatlux_session::{ClientSession, Machine, SessionFailure};

use crate::{Policy, PolicyError, RoundTrips};
pub use access::{Access, AccessArgs};
pub(crate) use discover::DISCOVERY_S;
pub use discover::{describe_servers, find_server, live_servers};
pub use error::ClientError;
use mailbox::Mailbox;
use query::{Content, GreetingReply, Sealing};
use subscriptions::{subscribe, watch};

/// Longest wait for an answer to `open`, s: the server may have to build the scene first.
pub(crate) const OPEN_TIMEOUT_S: f64 = 60.0;

/// Longest wait for an answer to a look, s: features of a large image take some tenths of a second.
const LOOK_TIMEOUT_S: f64 = 5.0;

/// Number of times that a look is requested.
const LOOK_TRIES: u32 = 4;

/// Longest wait for an answer to `close`, s.
const CLOSE_TIMEOUT_S: f64 = 3.0;

/// Longer than a server waits for its recorder before it stages an episode, but shorter than the session waits for the
/// query.
const RESET_TIMEOUT: Duration = Duration::from_secs(15);

const LAST_OBSERVATION_TIMEOUT: Duration = Duration::from_secs(2);

/// Time between two questions to a policy that waits.
const WAITING_PERIOD: Duration = Duration::from_millis(10);

/// Time between two messages that keep a session open whose policy waits, and the longest wait for the answer to one, s.
const KEEPING_PERIOD: Duration = Duration::from_secs(5);
const KEEPING_TIMEOUT_S: f64 = 1.0;

/// Number of times that such a message is sent before the server counts as gone.
const KEEPING_TRIES: u32 = 5;

/// Number of attempts to claim a session, and the longest time for each, s: the server closes a session that is not claimed within 5 s.
const CLAIM_TRIES: u32 = 8;
const CLAIM_TIMEOUT_S: f64 = 0.5;

/// Time for which sessions are opened again that the server closes before they are used.
const REOPEN_TIME: Duration = Duration::from_secs(5);

/// Longest time until a requested stop is noticed.
const STOP_PERIOD: Duration = Duration::from_millis(50);

/// An open session. [`Client::close`] ends it at once; if a client is only dropped, the server ends it after the grace
/// time.
#[derive(Debug)]
pub struct Client {
    link: Carrier,
    keys: SessionKeys,
    info: SessionInfo,
    mailbox: Arc<Mailbox>,
    /// Sends actions for which the server waits.
    actions: Publisher,
    /// Sends actions that are ahead of it, several in a packet.
    actions_ahead: Publisher,
    sealing: Sealing,
    /// Opens the session's records; `None` unless the session is a replay.
    rows: Option<RowsKey>,
    state: ClientSession,
    origin: Instant,
    round_trips: RoundTrips,
    /// Receiver of the server's notices; without one they go to the log.
    notices: Option<Sender<Notice>>,
    _token: Declaration,
    _subscribers: [Declaration; 3],
}

impl Client {
    /// Opens a session on the server of that name, or on the only one that answers. Fills in the protocol's version.
    ///
    /// # Errors
    /// [`ClientError`]: no server or several, a refused request, another version.
    pub fn open(link: &Carrier, server: Option<&str>, request: OpenRequest) -> Result<Self, ClientError> {
        Self::open_with(link, server, request, &Access::default())
    }

    /// As [`Client::open`], with keys and tokens: refuses a server with another key.
    ///
    /// # Errors
    /// As for [`Client::open`]; [`ClientError::Handshake`] and [`ClientError::UnknownServer`] for a server of another key.
    pub fn open_with(
        link: &Carrier,
        server: Option<&str>,
        request: OpenRequest,
        access: &Access,
    ) -> Result<Self, ClientError> {
        let server = find_server(link, server)?;
        let start = Instant::now();
        loop {
            match Self::open_once(link, &server, request.clone(), access) {
                // Others open more sessions than the server has places: it closed this one before it was used.
                Err(ClientError::Crowded { .. }) if start.elapsed() < REOPEN_TIME => {}
                opened => return opened,
            }
        }
    }

    fn open_once(link: &Carrier, server: &str, request: OpenRequest, access: &Access) -> Result<Self, ClientError> {
        let is_replay = request.replay;
        let key = ServerKeys::new(server).open();
        let (info, secrets) = query::greet(
            link,
            server,
            access,
            [&key, "OpenRequest"],
            OPEN_TIMEOUT_S,
            |hello| OpenRequest { protocol: Some(PROTOCOL), hello: Some(hello), ..request }.encode_to_vec(),
            |_| Vec::new(),
            |reply| {
                let reply = decode::<OpenReply>(&reply.as_ref().ok()?.payload, MAX_SERVER_MESSAGE);
                Some(reply.map_err(ClientError::unreadable(server)).and_then(|OpenReply { reply, welcome }| {
                    let content = match reply {
                        Some(open_reply::Reply::Session(info)) => Ok(info),
                        Some(open_reply::Reply::Refusal(refusal)) => Err(refusal),
                        None => return Err(ClientError::Session { reason: "the reply is empty".into() }),
                    };
                    Ok(GreetingReply { content, is_sealed: false, welcome })
                }))
            },
        )?;
        let mut client = Self::enter(link, server, info, &secrets)?;
        if is_replay {
            client.rows = Some(RowsKey::of_opener(&secrets).map_err(ClientError::handshake(server))?);
        }
        Ok(client)
    }

    /// Enters a session that the server has already opened for this client.
    pub(crate) fn enter(
        link: &Carrier,
        server: &str,
        info: SessionInfo,
        secrets: &Secrets,
    ) -> Result<Self, ClientError> {
        let info = check(info)?;
        let channel = Channel::new(secrets, Side::Client).map_err(ClientError::handshake(server))?;
        let sealing = Sealing::new(channel);
        let keys = ServerKeys::new(server).session(&info.session);
        let token = link.token(&keys.client())?;
        let mailbox = Arc::new(Mailbox::default());
        let subscribers = [
            subscribe(link, keys.observation(), "observation", &sealing, &mailbox, Input::Observation)?,
            subscribe(link, keys.notice(), "notice", &sealing, &mailbox, Input::Notice)?,
            watch(link, keys.live(), &mailbox)?,
        ];
        let publisher = |waits: bool| {
            // Priority over everything else on the link.
            let quality = Quality { priority: Priority::RealTime, express: waits, blocking: true };
            link.publisher(&keys.action(), "Action", quality, Reach::Everywhere)
        };
        let (actions, actions_ahead) = (publisher(true)?, publisher(false)?);
        let state = ClientSession::new(&info);
        // Nothing is lost between threads of one process: what is slow there is a busy machine.
        let state = if link.delivers_in_place() { state.patient() } else { state };
        let client = Self {
            link: link.clone(),
            sealing,
            rows: None,
            state,
            keys,
            info,
            mailbox,
            actions,
            actions_ahead,
            origin: Instant::now(),
            round_trips: RoundTrips::default(),
            notices: None,
            _token: token,
            _subscribers: subscribers,
        };
        client.claim()?;
        Ok(client)
    }

    /// Tells the server that the session is in use; otherwise the server soon closes it.
    fn claim(&self) -> Result<(), ClientError> {
        let (server, key) = (&self.info.server, self.keys.observation());
        for _ in 0..CLAIM_TRIES {
            let said = self.sealing.ask(&self.link, server, &key, "observation", "", &CloseRequest {}, CLAIM_TIMEOUT_S);
            match said {
                Err(ClientError::Unanswered { .. }) => {}
                Err(ClientError::Refused { code: Code::Closed, .. }) => {
                    return Err(ClientError::Crowded { server: server.clone() });
                }
                // An answer that no episode runs will do.
                _ => return Ok(()),
            }
        }
        Ok(())
    }

    /// Takes the key to the session's records, which only a session that is a replay has; the next call gives `None`.
    pub fn take_rows_key(&mut self) -> Option<RowsKey> {
        self.rows.take()
    }

    /// The session's description, as the server sent it.
    pub fn info(&self) -> &SessionInfo {
        &self.info
    }

    /// Durations of all steps so far, over all episodes.
    pub fn round_trips(&self) -> &RoundTrips {
        &self.round_trips
    }

    /// Sends the server's notices to a channel instead of the log.
    pub fn send_notices(&mut self, to: Sender<Notice>) {
        self.notices = Some(to);
    }

    /// Runs one episode. `progress` receives the step of each observation before the policy answers it. Setting `stop`
    /// ends the run with [`ClientError::Stopped`].
    ///
    /// # Errors
    /// The policy fails, the server refuses or does not answer, the link is lost for too long, or `stop` is set.
    pub fn run_episode(
        &mut self,
        episode: u64,
        policy: &mut dyn Policy,
        progress: &mut dyn FnMut(u64),
        stop: &AtomicBool,
    ) -> Result<EpisodeEnd, ClientError> {
        let mut present: Option<Box<Observation>> = None;
        let mut is_reset = false;
        let mut busy = BusyWait::default();
        let mut kept_at = Instant::now();
        self.state.handle(Input::Start(episode), self.now());
        loop {
            if stop.load(Ordering::Relaxed) {
                return Err(ClientError::Stopped);
            }
            let now = self.now();
            while let Some(input) = self.mailbox.take() {
                self.tell_of(&input);
                self.state.handle(input, now);
            }
            self.state.handle(Input::Tick, now);
            while let Some(output) = self.state.poll() {
                match output {
                    Output::Done(end) => return Ok(end),
                    Output::Failed(failure) => return Err(failed(failure, policy)),
                    Output::RoundTrip(time) => self.round_trips.push(time.as_secs_f64()),
                    Output::Observation(observation) => present = Some(observation),
                    Output::Action(bytes) => {
                        let (attachment, _) = self.sealing.seal("action", &bytes);
                        let publisher = if self.state.is_ahead() { &self.actions_ahead } else { &self.actions };
                        publisher.put(bytes, attachment)?;
                    }
                    Output::Reset(bytes) => {
                        self.post(&self.keys.reset(), "reset", bytes, RESET_TIMEOUT, Input::Reset)?;
                    }
                    Output::AskObservation => {
                        let (key, timeout) = (self.keys.observation(), LAST_OBSERVATION_TIMEOUT);
                        self.post(&key, "observation", Bytes::new(), timeout, Input::LastObservation)?;
                    }
                }
            }
            if let Some(step) = self.state.next_step()
                && let Some(command) = policy.foresee(step)
            {
                progress(step);
                self.state.handle(Input::Command(command), self.now());
                continue;
            }
            let Some(observation) = &present else {
                let wake = self.state.wake_at().map_or(STOP_PERIOD, |at| at.saturating_sub(self.now()));
                // The server has work: to poll would only take its core's time.
                let busy = (!self.state.is_ahead()).then_some(&mut busy);
                self.mailbox.wait(wake.min(STOP_PERIOD), busy);
                continue;
            };
            if !is_reset {
                policy.reset(&self.info, observation)?;
                is_reset = true;
                kept_at = Instant::now();
            }
            if observation.step == 0 && policy.waits(observation) {
                std::thread::sleep(WAITING_PERIOD);
                if kept_at.elapsed() >= KEEPING_PERIOD.min(Duration::from_secs_f64(self.info.action_timeout_s / 2.0)) {
                    self.keep_open(episode)?;
                    kept_at = Instant::now();
                }
                continue;
            }
            progress(observation.step);
            let asked = policy.look(observation);
            let command = if asked.is_empty() {
                policy.act(observation)?
            } else {
                let mut observation = observation.clone();
                match self.look(&observation, &asked) {
                    Ok(seen) => observation.overlay(&seen),
                    // In real time the step may already be over.
                    Err(ClientError::Refused { field, .. }) if self.is_real_time() && field == "step" => continue,
                    Err(error) => return Err(error),
                }
                policy.act(&observation)?
            };
            present = None;
            if let Some(chunk) = policy.source() {
                self.state.handle(Input::Chunk(Box::new(chunk)), self.now());
            }
            self.state.handle(Input::Command(command), self.now());
        }
    }

    /// Starts an episode anew that has not begun, so that its session's time does not run out. Returns once the server has
    /// answered: a reset that came after the first action would end the episode.
    fn keep_open(&self, episode: u64) -> Result<(), ClientError> {
        let (server, key, request) = (&self.info.server, self.keys.reset(), ResetRequest { episode });
        let mut tries = 1;
        let bytes = loop {
            let ask = self.sealing.ask(&self.link, server, &key, "reset", "ResetRequest", &request, KEEPING_TIMEOUT_S);
            match ask {
                Err(ClientError::Unanswered { .. }) if tries < KEEPING_TRIES => tries += 1,
                answered => break answered?,
            }
        };
        match decode::<ResetReply>(&bytes, MAX_SERVER_MESSAGE).map_err(ClientError::unreadable(server))?.reply {
            Some(reset_reply::Reply::Refusal(refusal)) => Err(ClientError::refused(server, refusal)),
            _ => Ok(()),
        }
    }

    /// Closes the session, which saves the server waiting for the grace time.
    ///
    /// # Errors
    /// The server does not answer, or has already closed the session.
    pub fn close(self) -> Result<(), ClientError> {
        let (server, key) = (&self.info.server, self.keys.close());
        let closed =
            self.sealing.ask(&self.link, server, &key, "close", "CloseRequest", &CloseRequest {}, CLOSE_TIMEOUT_S);
        // That the recording of the last episode is lost may be known only now.
        while let Some(input) = self.mailbox.take() {
            self.tell_of(&input);
        }
        let reply = decode::<CloseReply>(&closed?, MAX_SERVER_MESSAGE);
        match reply.map_err(ClientError::unreadable(&self.info.server))?.refusal {
            Some(refusal) => Err(ClientError::refused(&self.info.server, refusal)),
            None => Ok(()),
        }
    }

    /// Reads sensors of the session at the step of an observation, which must be the current one.
    ///
    /// # Errors
    /// The server refuses (another step is current, or the session lacks the sensor) or does not answer.
    pub fn look(&self, observation: &Observation, sensors: &[&str]) -> Result<Observation, ClientError> {
        let request = LookRequest {
            episode: observation.episode,
            step: observation.step,
            sensors: sensors.iter().map(|name| (*name).into()).collect(),
        };
        let server = &self.info.server;
        let mut tries = 1;
        let bytes = loop {
            let key = self.keys.look();
            match self.sealing.ask(&self.link, server, &key, "look", "LookRequest", &request, LOOK_TIMEOUT_S) {
                // The request or its answer may have been lost.
                Err(ClientError::Unanswered { .. }) if tries < LOOK_TRIES => tries += 1,
                answered => break answered?,
            }
        };
        let reply = decode::<LookReply>(&bytes, MAX_SERVER_MESSAGE).map_err(ClientError::unreadable(server))?;
        match reply.reply {
            Some(look_reply::Reply::Observation(seen)) => {
                self.state.check(seen).map_err(|reason| ClientError::Session { reason })
            }
            Some(look_reply::Reply::Refusal(refusal)) => Err(ClientError::refused(server, refusal)),
            None => Err(ClientError::Session { reason: "the reply to a look is empty".into() }),
        }
    }

    fn is_real_time(&self) -> bool {
        self.info.mode() == Mode::RealTime
    }

    fn now(&self) -> Duration {
        self.origin.elapsed()
    }

    /// Passes on a notice from the server.
    fn tell_of(&self, input: &Input) {
        if let Input::Notice(bytes) = input
            && let Ok(notice) = decode::<Notice>(bytes, MAX_SERVER_MESSAGE)
            && !self.state.is_left_over(&notice)
        {
            self.tell(notice);
        }
    }

    fn post(
        &self,
        key: &str,
        label: &str,
        bytes: Bytes,
        timeout: Duration,
        end: fn(Answer) -> Input,
    ) -> Result<(), ClientError> {
        query::post(&self.link, [key, label], bytes, timeout, &self.sealing, &self.mailbox, end)
    }

    /// Sends a notice to the channel, if its receiver still exists, or to the log.
    fn tell(&self, notice: Notice) {
        match &self.notices {
            Some(to) => drop(to.send(notice)),
            None => {
                let Notice { episode, step, message, remedy, .. } = notice;
                tracing::warn!(
                    "notice of the server, episode {episode} step {step}: {}; {}",
                    plain(&message),
                    plain(&remedy)
                );
            }
        }
    }
}

/// A command that every server would refuse is the policy's error.
fn failed(failure: SessionFailure, policy: &dyn Policy) -> ClientError {
    match failure {
        SessionFailure::Command { field, problem, step } => {
            PolicyError::Command { policy: policy.name(), field, problem, step }.into()
        }
        failure => failure.into(),
    }
}

impl Content for SessionInfo {
    fn id(&self) -> &str {
        &self.session
    }
}

/// Refuses a session in which no policy could work.
fn check(info: SessionInfo) -> Result<SessionInfo, ClientError> {
    let refuse = |reason: String| Err(ClientError::Session { reason });
    match info.protocol {
        Some(version) if is_compatible(&version) => {}
        Some(found) => return Err(ClientError::Version { server: info.server, found }),
        None => return refuse("it has no protocol version".into()),
    }
    if !is_name(&info.session) {
        return refuse(format!("its id '{}' cannot be part of a key", info.session.escape_debug()));
    }
    if let Err(error) = ObservationLayout::new(&info) {
        return refuse(error.to_string());
    }
    if info.joints.is_empty() {
        return refuse("its robot has no joints".into());
    }
    let numbers = info.joints.iter().flat_map(|j| [j.lower, j.upper, j.q0, j.stiffness, j.damping, j.effort_limit]);
    if !numbers.chain([info.control_dt, info.action_scale, info.action_limit]).all(f64::is_finite) {
        return refuse("a number of its robot is not finite".into());
    }
    Ok(info)
}
